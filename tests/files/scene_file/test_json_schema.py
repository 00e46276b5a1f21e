"""The JSON Schema of scene files says what the reader says, of whole scenes and of mistakes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from pydantic import ValidationError
from toy_scene_files import DM_SCENE, LIGHT, SCENE, changed, load, write_toy

from pftwin.files.scene_file.json_schema import scene_json_schema
from pftwin.files.scene_file.loading import SCHEMA, scene_file_model
from pftwin.files.scene_file.section import ValidationRecords, other_unit
from pftwin.rig.scene_template import write_example

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGES = ("bring_your_own_knee.md", "effects.md", "fitting.md", "mesh_contact.md")
FENCE = re.compile(r"^```toml\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def schema() -> Draft202012Validator:
    """Itself a schema that keeps to the standard."""
    made = scene_json_schema()
    Draft202012Validator.check_schema(made)
    return Draft202012Validator(made)


def read(data: dict[str, Any]) -> bool:
    """Whether the reader's own models take it."""
    try:
        scene_file_model().model_validate(data, context=ValidationRecords())
    except ValidationError:
        return False
    return True


def examples() -> list[tuple[str, str]]:
    """Every example of the documentation; where it is a part, in the place of that part of a whole scene."""
    found = []
    for page in PAGES:
        for k, text in enumerate(FENCE.findall((DOCS / page).read_text(encoding="utf-8"))):
            found.append((f"{page} {k}", text))
    return found


def whole(text: str) -> dict[str, Any]:
    data = tomllib.loads(text)
    return data if "schema" in data else {**tomllib.loads(LIGHT), **data}


def test_it_says_its_version(schema):
    assert schema.schema["$id"] == f"urn:pftwin:scene:{SCHEMA}"
    assert not schema.is_valid({**tomllib.loads(SCENE), "schema": SCHEMA + 1})


@pytest.mark.parametrize("text", [SCENE, LIGHT, DM_SCENE], ids=["toy", "patch", "dm"])
def test_scenes_of_the_tests_are_valid(schema, text):
    data = tomllib.loads(text)
    assert read(data)
    schema.validate(data)


@pytest.mark.parametrize(("name", "text"), examples(), ids=[name for name, _ in examples()])
def test_examples_of_the_documentation_are_valid(schema, name, text):
    data = whole(text)
    assert read(data)
    schema.validate(data)


def test_there_are_examples():
    assert len(examples()) >= 10


@pytest.mark.parametrize("case", [1, 2])
def test_the_scene_that_the_rig_writes_is_valid(schema, tmp_path, case):
    write_example(tmp_path, case)
    schema.validate(tomllib.loads((tmp_path / "scene.toml").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mass_kg", "mas_kg"),
        ("mass_kg = 0.12", 'mass_kg = "0.12"'),
        ("mass_kg = 0.12", "mass_kg = -0.12"),
        ("mass_kg = 0.12", "mass_kg = 0.12\nmass_kgs = 1"),
        ("[gravity]", "[gravty]"),
        ("acceleration_m_per_s2 = [0, 0, -9.81]", "acceleration_m_per_s2 = [0, 0]"),
        ("slack_length_mm = 143.2", "slack_lenght_mm = 143.2"),
        ("slack_length_mm = 143.2", "slack_length_mm = 143.2\nslack_length_m = 0.1432"),
        ("slack_length_mm = 143.2", "slack_length_mm = [143.2, 0]"),
        ("slack_length_mm = 143.2", "slack_length_cm = 14.32"),
        ("slack_length_mm = 143.2\n", ""),
        ('body = "tibia"', 'body = "shin"'),
        ('type = "flores"', 'type = "flowers"'),
        ("restitution = 0.6", "restituton = 0.6"),
        ("restitution = 0.6", "restitution = 1.6"),
        ('type = "plane"', 'type = "plain"'),
        ("half_size_mm = [24, 20]", "half_size_mm = [24, 20, 20]"),
        ("[gravity]", '[axes]\nfemur = "isbn"\n[gravity]'),
        ("schema = 1", "schema = 2"),
        ("schema = 1", 'schema = 1\nside = "both"'),
    ],
)
def test_mistakes_are_refused_by_both(schema, old, new):
    text = changed(old, new)
    if old == 'body = "tibia"':  # of a tendon: the first is a name in the recording
        text = new.join(LIGHT.rsplit(old, 1))
    data = tomllib.loads(text)
    assert not read(data)
    assert not schema.is_valid(data)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("slack_length_mm = 143.2", "slack_length_m = 0.1432"),
        ("slack_length_mm = 143.2", "slack_length_mm = [143.2, 143.2]"),
        ("stiffness_N_per_m = 156", "stiffness_N_per_mm = 0.156"),
        ("insertion_mm = [20, 0, -8]", "insertion_mm = [[20, 0, -8], [21, 0, -8]]"),
        ("[contact]", "[[contact]]"),
        ("radius_mm = 22", "radius_m = 0.022"),
        ("[gravity]", '[axes]\nfemur = "isb"\ntibia = ["+y", "+z", "+x"]\n[gravity]'),
    ],
)
def test_what_may_be_written_in_two_ways_is_taken_by_both(schema, old, new):
    data = tomllib.loads(changed(old, new))
    assert read(data)
    schema.validate(data)


def test_what_is_per_millimetre_is_a_thousand_times_as_much_per_metre(tmp_path):
    """A spring of 0.156 N/mm is one of 156 N/m."""
    write_toy(tmp_path)
    per_metre = load(tmp_path, LIGHT).effect("quadriceps")
    per_millimetre = load(tmp_path, changed("stiffness_N_per_m = 156", "stiffness_N_per_mm = 0.156")).effect(
        "quadriceps"
    )
    assert float(per_millimetre.stiffness) == pytest.approx(float(per_metre.stiffness), rel=1e-12)
    assert float(per_metre.stiffness) == 156
    assert other_unit("radius_m") == ("radius_mm", 1e-3)
    assert other_unit("mass_kg") is None
