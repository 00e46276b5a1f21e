"""The page of scene files names every field that a file may have, and nothing it may not."""

from __future__ import annotations

import re

import pytest
import scene_reference

from pftwin.files.scene_file.loading import scene_file_model
from pftwin.files.scene_file.registry import EFFECTS

_FIELD = re.compile(r"^\| `(\w+)` \|", re.MULTILINE)


@pytest.fixture(scope="module")
def page() -> str:
    return scene_reference.reference()


def fields_by_anchor(page: str) -> dict[str, list[str]]:
    parts = re.split(r"^#+ .*\{#([\w-]+)\}$", page, flags=re.MULTILINE)
    return {name: _FIELD.findall(text) for name, text in zip(parts[1::2], parts[2::2], strict=True)}


def test_every_field_of_the_schema_is_there(page: str) -> None:
    schema = scene_file_model().model_json_schema()  # walked by pydantic, not by the hook
    models = {**schema["$defs"], "SceneFile": schema}
    named = {model.__name__: scene_reference.anchor(model) for model in scene_reference.tables()}
    assert set(named) == set(models)
    found = fields_by_anchor(page)
    for name, model in models.items():
        assert found[named[name]] == list(model["properties"]), name


def test_required_fields_and_no_others_are_called_required(page: str) -> None:
    schema = scene_file_model().model_json_schema()
    required = sum(len(m.get("required", ())) for m in (schema, *schema["$defs"].values()))
    assert page.count("**required**") == required > 50


def test_the_json_schema_is_offered_under_its_version(page: str) -> None:
    assert f"]({scene_reference.SCHEMA_FILE})" in page


def test_each_effect_has_a_table(page: str) -> None:
    for effect in EFFECTS:
        assert f"### `[{effect.kind}]` " in page


def test_every_row_says_what_the_field_means(page: str) -> None:
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 150
    for row in rows:
        assert re.search(r"\| [^|]*\w[^|]* \|$", row.replace("\\|", "")), row


def test_links_lead_to_tables_on_the_page(page: str) -> None:
    anchors = set(re.findall(r"\{#([\w-]+)\}", page))
    links = set(re.findall(r"\]\(#([\w-]+)\)", page))
    assert links
    assert links <= anchors


@pytest.mark.parametrize(
    ("field", "unit", "kind", "default"),
    [
        ("acceleration_m_per_s2", "m/s^2", "3 numbers", "**required**"),
        ("toe_strain", "-", "number, above 0, or a list", "`0.06`"),
        ("side", "", '`"right"` or `"left"`', '`"right"`'),
        ("restitution", "-", "number, above 0, at most 1", "**required**"),
        ("half_size_m", "m", "2 numbers, above 0", "**required**"),
    ],
)
def test_rows_as_they_should_be(page: str, field: str, unit: str, kind: str, default: str) -> None:
    assert f"| `{field}` | {unit} | {kind} | {default} |" in page
