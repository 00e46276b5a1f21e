"""docs/cohorts.md: its cohort file is one, its programs run."""

from __future__ import annotations

import re
from pathlib import Path

from cheap_cohort import CheapWork, write_cohort

from fitting.cohort import read_cohort, run_cohort
from fitting.cohort.description import CohortTable, FitTable, PatientTable, PredictTable
from fitting.cohort.summary import FIXED

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "cohorts.md").read_text(encoding="utf-8")


def example(name: str) -> str:
    found = re.search(rf"<!-- example: {name} -->\n```\w+\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_cohort_file(tmp_path):
    (tmp_path / "cohort.toml").write_text(example("cohort"))
    cohort = read_cohort(tmp_path / "cohort.toml")
    assert [p.name for p in cohort.patients] == ["P01", "P02", "rig"]
    assert [p.fit["bounds"] for p in cohort.patients if p.fit] == [0.3, 0.5, 0.3]
    assert len(cohort.treatments) == 2
    assert cohort.output == tmp_path / "results"


def test_every_field_is_in_it():
    text = example("cohort")
    for table in (CohortTable, FitTable, PredictTable, PatientTable):
        for name, field in table.model_fields.items():
            name = field.alias or name
            assert re.search(rf"^(\[+(patient\.)?{name}\]|(# )?{name} = )", text, re.MULTILINE), name


def test_every_column_is_in_its_table():
    assert all(f"`{name}`" in PAGE for name in FIXED)


def test_the_programs_run(tmp_path, monkeypatch):
    cohort = read_cohort(write_cohort(tmp_path, 2))
    run_cohort(cohort, tmp_path / "results", work=CheapWork())
    monkeypatch.chdir(tmp_path)
    for name in ("pandas", "duckdb"):
        exec(compile(example(name), name, "exec"), {})
