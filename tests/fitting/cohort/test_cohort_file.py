"""The cohort file: what it may say, and what is said about mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest
from cheap_cohort import HEAD, write_cohort

from fitting.cohort import read_cohort
from fitting.cohort.description import FitTable
from fitting.fit import METHODS, SIMULATIONS
from fitting.objective import LOSSES, OBJECTIVES
from fitting.prediction.variants import amounts_of, combinations
from fitting.treatments import KINDS
from pftwin.base.errors import InputError

PATIENT = '\n[[patient]]\nname = "A"\ncase = 1\n'


def read(folder: Path, text: str, **options):
    (folder / "cohort.toml").write_text(text)
    return read_cohort(folder / "cohort.toml", **options)


def refused(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, text)
    return str(caught.value).replace(f"{folder}/", "")


def test_patients_override_the_fit(tmp_path):
    text = HEAD + PATIENT + '[patient.fit]\nbounds = 0.5\nuse = "all"\n' + PATIENT.replace('"A"', '"B"')
    a, b = read(tmp_path, text).patients
    assert a.fit == {"free": ["K1", "L1"], "bounds": 0.5, "use": "all"}
    assert b.fit == {"free": ["K1", "L1"]}
    assert (a.case, a.scene) == (1, None)


def test_nuisance_is_what_fits_take(tmp_path):
    a = read(tmp_path, HEAD + PATIENT + '[patient.fit]\nnuisance = "attachments=0.001,friction=0.04"\n').patients[0]
    assert a.fit["nuisance"] == "attachments=0.001,friction=0.04"
    said = refused(tmp_path, HEAD + PATIENT + '[patient.fit]\nnuisance = "rigs"\n')
    assert "found 'rigs'" in said
    assert "one of: rig, mocap, mri" in said


def test_ranges_become_all_combinations_in_si(tmp_path):
    table = """
[[treatment]]
tibial_tuberosity_transfer = { medialisation_mm = "0:10:5", distalisation_mm = [0, 4] }
lateral_release = { release_percent = 50 }
[[treatment]]
femoral_component_rotation = { external_rotation_deg = -3 }
"""
    first, second = read(tmp_path, "schema = 1\n" + table + PATIENT).treatments
    found = amounts_of(combinations(first))
    assert found.round(9).tolist() == [[m, d, 0.5] for m in (0.0, 0.005, 0.01) for d in (0.0, 0.004)]
    assert amounts_of(combinations(second)).tolist() == [[pytest.approx(-0.05235987756)]]


def test_every_amount_of_every_treatment_can_be_given(tmp_path):
    units = {"mm": "mm", "deg": "deg", "%": "percent"}
    for kind, about in KINDS.items():
        inner = ", ".join(f"{n}_{units[way.shown_unit]} = 1" for n, way in about.amounts.items())
        (found,) = read(tmp_path, f"schema = 1\n[[treatment]]\n{kind} = {{ {inner} }}\n" + PATIENT).treatments
        assert found == {kind: {name: [1.0] for name in about.amounts}}


def test_choices_are_those_of_fits():
    def choices(name: str) -> tuple[str, ...]:
        annotation = FitTable.model_fields[name].annotation
        return get_args(get_args(annotation)[0])

    assert choices("method") == (*METHODS, SIMULATIONS)
    assert choices("objective") == OBJECTIVES
    assert choices("loss") == LOSSES


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema = 2\n[fit]\n" + PATIENT, "cohort.toml, line 1, schema: found 2; expected: one of 1"),
        ("schema = 1\n" + PATIENT, "neither a fit nor a treatment; expected: a table [fit]"),
        (HEAD, "patient: is missing; expected: tables [[patient]]: who"),
        (
            HEAD + PATIENT + PATIENT,
            "line 14, [[patient]] number 1 (A), name: 2 patients are called 'A', also line 18, ",
        ),
        (
            HEAD + PATIENT + PATIENT.replace('"A"', '"B"') + PATIENT.replace('"A"', '"a"'),
            "cohort.toml, line 14, [[patient]] number 1 (A), name: 2 patients are called 'A', also line 22, [[patient]]"
            " number 3 (a), name; expected: names that differ by more than capital letters",
        ),
        (HEAD + PATIENT.replace('"A"', '"../A"'), "name: found '../A'"),
        (HEAD + PATIENT.replace('"A"', '"aux"'), "found 'aux', which Windows takes for a device"),
        (HEAD + PATIENT.replace("case = 1", ""), "[[patient]] number 1 (A): neither scene nor case given"),
        (HEAD + PATIENT + 'scene = "a.toml"\n', "both scene and case given"),
        (
            HEAD + PATIENT.replace("case = 1", 'scene = "../a.toml"'),
            "leads out of the cohort file's folder",
        ),
        (HEAD + PATIENT + 'contact = "P77"\n', "[[patient]] number 1 (A), contact"),
        (HEAD.replace("free", "fre") + PATIENT, "line 5, [fit] fre: unknown field; expected: did you mean free?"),
        (HEAD.replace("[0, 10]", '"0:10:0"') + PATIENT, "expected: a step that leads from the first to the last"),
        (HEAD.replace("[0, 10]", "true") + PATIENT, 'expected: a number, a list of numbers, or "FROM:TO:STEP"'),
        (HEAD.replace("[0, 10]", "[]") + PATIENT, "medialisation_mm: found []"),
        (HEAD.replace("_mm", "_cm") + PATIENT, "did you mean medialisation_mm"),
        (HEAD + "[[treatment]]\n" + PATIENT, "[[treatment]] number 2: no treatment given; expected: such as"),
        (HEAD.replace("[0, 10]", '"0:999999"') + PATIENT, "at most 1000000 simulations of a patient, and not 3000000"),
        (HEAD.replace("samples = 2", "samples = -1") + PATIENT, "[predict] samples: found -1"),
        (HEAD.replace('name = "cheap"', 'output = "../x"') + PATIENT, "output: '../x' leads out of"),
        (
            HEAD.replace('name = "cheap"', 'output = "x\\u0000y"') + PATIENT,
            "output: found 'x\\x00y'; expected: a name of print",
        ),
        (HEAD + PATIENT.replace('"A"', '"\\u001b[31mA"'), "[[patient]] number 1, name: found '\\x1b[31mA'; expected"),
        ("schema = ", "not valid TOML"),
    ],
)
def test_mistakes_are_named_by_line_and_field(tmp_path, text, message):
    assert message in refused(tmp_path, text)


def test_files_elsewhere_with_leave(tmp_path):
    text = HEAD + PATIENT.replace("case = 1", 'scene = "../a.toml"')
    (tmp_path / "b").mkdir()
    assert read(tmp_path / "b", text, allow_outside=True).patients[0].scene == tmp_path / "b/../a.toml"


def test_a_missing_scene_is_its_patients_matter(tmp_path):
    path = write_cohort(tmp_path, 2)
    (tmp_path / "B.toml").unlink()
    assert len(read_cohort(path).patients) == 2
