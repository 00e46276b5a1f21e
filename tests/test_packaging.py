"""What goes with a release says what pyproject.toml says: types, citation, archive, conda recipe, paper."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PROJECT = PYPROJECT["project"]
RECIPE = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text("utf-8"))
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
PAPER = (ROOT / "docs" / "paper" / "paper.md").read_text("utf-8")
REFERENCES = (ROOT / "docs" / "paper" / "paper.bib").read_text("utf-8")
IN_CONDA = {"flatbuffers": "python-flatbuffers", "matplotlib": "matplotlib-base"}  # names that differ there


@pytest.mark.parametrize("package", ["pftwin", "fitting"])
def test_packages_say_that_they_are_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").read_text() == ""


def test_the_archive_says_what_the_citation_says() -> None:
    archive: dict[str, Any] = json.loads((ROOT / ".zenodo.json").read_text("utf-8"))
    assert archive["version"] == CITATION["version"] == PROJECT["version"]
    assert archive["license"] == CITATION["license"] == PROJECT["license"]
    assert archive["title"] == CITATION["title"]
    assert archive["keywords"] == CITATION["keywords"]
    assert [c["name"] for c in archive["creators"]] == [a["name"] for a in CITATION["authors"]]
    dois = [r["doi"] for r in CITATION["references"]]
    assert [r["identifier"] for r in archive["related_identifiers"]] == dois


def bounds_by_name(lines: list[str]) -> dict[str, SpecifierSet]:
    """Of lines such as "numpy >=2.0"."""
    return {name: SpecifierSet(bounds) for name, _, bounds in (line.partition(" ") for line in lines)}


def test_the_recipe_needs_what_the_project_needs() -> None:
    """Names apart that are other ones in conda; Python's own line stands in both."""
    wanted = {IN_CONDA.get(r.name, r.name): r.specifier for r in map(Requirement, PROJECT["dependencies"])}
    context = RECIPE["context"]
    lines = [line.replace("${{ python_min }}", context["python_min"]) for line in RECIPE["requirements"]["run"]]
    found = bounds_by_name(lines)
    assert found.pop("python") == SpecifierSet(PROJECT["requires-python"])
    assert found == wanted
    built_with = {r.name: r.specifier for r in map(Requirement, PYPROJECT["build-system"]["requires"])}
    host = RECIPE["requirements"]["host"]
    assert bounds_by_name([line for line in host if not line.startswith("python ")]) == {
        **built_with,
        "pip": SpecifierSet(),
    }
    assert context["version"] == PROJECT["version"]
    assert RECIPE["about"]["license"] == PROJECT["license"]
    assert RECIPE["build"]["python"]["entry_points"] == [f"{n} = {at}" for n, at in PROJECT["scripts"].items()]


def test_every_citation_of_the_paper_has_its_entry_and_every_entry_is_cited() -> None:
    cited = set(re.findall(r"@([A-Z][\w-]+:\d{4})", PAPER))
    entries = re.findall(r"^@\w+\{([^,]+),$", REFERENCES, re.MULTILINE)
    assert len(entries) == len(set(entries))
    assert cited == set(entries)
    for entry in re.split(r"\n(?=@)", REFERENCES):
        assert re.search(r"^  (doi|url) = \{", entry, re.MULTILINE), entry.splitlines()[0]


def test_the_paper_is_short_and_has_what_its_journal_asks_for() -> None:
    """JOSS also asks how AI was used: its authors say so before they submit."""
    _, head, body = PAPER.split("---\n", maxsplit=2)
    about = yaml.safe_load(head)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(about)
    assert (ROOT / "docs" / "paper" / about["bibliography"]).is_file()
    assert {"Summary", "Statement of need", "Acknowledgements", "References"} <= set(
        re.findall(r"^# (.*)$", body, re.M)
    )
    assert 600 <= len(body.split()) <= 1000
