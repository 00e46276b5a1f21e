"""The paper's section 2.6: Table 2 is put together right, outcomes are called right."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from made_estimates import made_estimate

from fitting.cli.demo import _outcomes, _springs, _table_2
from fitting.demo.paper_study import (
    CASES,
    FITS,
    NOMINAL,
    PAPER,
    PATHOLOGY,
    TREATMENT,
    PaperStudy,
    simulated,
    with_springs,
)
from fitting.demo.paper_study_tables import facts, notes, outcome_rows, save, spring_rows, table_2
from fitting.demo.straight_springs import nearest_line, recorded_pulls
from fitting.estimate import Estimate
from pftwin import rig
from pftwin.dynamics.status import status_facts
from pftwin.results.tracking import find_dislocations
from tests.benchmarks.fitting.plant import paper_objective

NAMES = ("K1", "L1", "K2", "L2")
PUBLISHED = np.array([156.0, 0.1432, 629.0, 0.0714])
FOUND = {
    "paper": np.array([1.1, 1.05, 0.9, 1.01]),
    "positions": np.array([1.2, 1.0, 1.0, 0.98]),
    "force": np.array([1.17, 1.03, 1.1, 1.0]),
}
FRICTION = ("friction.coefficient", 0.02, 0.005)


def estimate(fit: str, share: np.ndarray, sd: float, seconds: float) -> Estimate:
    """An estimate as a fit leaves it, with relative standard deviations of sd; all but the paper's with nuisance."""
    numbers = dict(zip(NAMES, zip(PUBLISHED * share, sd * PUBLISHED, strict=True), strict=True))
    auxiliary = () if fit == "paper" else FRICTION[:1]
    numbers |= dict.fromkeys(auxiliary, FRICTION[1:])
    nominal = np.append(PUBLISHED, len(auxiliary) * [0.01])
    return made_estimate(
        numbers,
        nominal=nominal,
        lower=0.7 * nominal,
        upper=1.3 * nominal if fit == "paper" else 2.5 * nominal,
        auxiliary=auxiliary,
        objective="paper" if fit == "paper" else "likelihood",
        noise={"position": 1e-3},
        serial_correlation=0.9,
        condition=1e5,
        evaluations=100,
        iterations=10,
        starts=32,
        seconds=seconds,
    )


@pytest.fixture(scope="module")
def nominal():
    """Both cases of the rig with the published springs."""
    return {n: simulated(n, NOMINAL, with_springs(rig.case(n), PUBLISHED)) for n in CASES}


@pytest.fixture(scope="module")
def study(nominal):
    """With made-up fits, whose runs differ from the nominal ones in one number each."""
    pulls = recorded_pulls(PATHOLOGY)
    runs = {NOMINAL: nominal}
    for i, fit in enumerate(FITS):
        changed = {n: replace(run.validation, mean_distance=10.0 * n + i) for n, run in nominal.items()}
        runs[fit] = {n: run._replace(validation=changed[n]) for n, run in nominal.items()}
    fits = {fit: estimate(fit, FOUND[fit], 0.02 * (i + 1), 1.0 + i) for i, fit in enumerate(FITS)}
    return PaperStudy(fits, {name: nearest_line(pull) for name, pull in pulls.items()}, runs)


def test_the_springs_errors_stand_beside_the_papers(study):
    rows = {row["row"]: row for row in table_2(study)}
    expected = {
        "K1": (10.0, 20.0, 17.0, 8),
        "L1": (5.0, 0.0, 3.0, 13),
        "K2": (-10.0, 0.0, 10.0, 5),
        "L2": (1.0, -2.0, 0.0, 3),
    }
    for name, (*by_fit, published) in expected.items():
        row = rows[f"{name} error of nominal"]
        assert row["unit"] == "%"
        assert [row[f"case2_by_{fit}"] for fit in FITS] == pytest.approx(by_fit, abs=1e-9)
        assert row["case1_by_paper"] is None
        assert (row["case2_published"], row["case1_published"]) == (published, None)
    assert rows["time of the fit, with compiling"]["case2_by_positions"] == 2.0
    assert rows["time of the fit, with compiling"]["case2_published"] == 1233


def test_each_case_is_compared_with_its_own_measurements_beside_the_papers(study, nominal):
    rows = {row["row"]: row for row in table_2(study)}
    distance = rows["mean distance"]
    for n in CASES:
        assert [distance[f"case{n}_by_{fit}"] for fit in FITS] == [10.0 * n + i for i in range(len(FITS))]
        assert distance[f"case{n}_published"] == {2: 1.66, 1: 2.61}[n]
        assert rows["contact force RMSE"][f"case{n}_published"] is None
    for label, field in (("tilt RMSE", "tilt"), ("tibial spring RMSE", "tibial_spring")):
        for n in CASES:
            assert rows[label][f"case{n}_by_paper"] == getattr(nominal[n].validation, field)
            assert rows[label][f"case{n}_published"] == PAPER.table_2[n][field]
    assert nominal[1].validation.scene == "rig case 1, P5"


def test_errors_of_the_line_and_what_intervals_cover(study):
    line = study.line
    rows = {fit: {row["name"]: row for row in spring_rows(study, fit)} for fit in FITS}
    for i, name in enumerate(("K1", "L1", "K2", "L2")):
        for fit in FITS:
            row = rows[fit][name]
            assert row["error_of_line"] == pytest.approx(100 * (PUBLISHED[i] * FOUND[fit][i] / line[i] - 1))
            assert row["error"] == pytest.approx(100 * (FOUND[fit][i] - 1))
    l1 = rows["paper"]["L1"]
    assert (l1["unit"], l1["nominal"], l1["paper_error"]) == ("mm", pytest.approx(143.2), 13)
    assert (l1["high"] - l1["low"]) / 143.2 == pytest.approx(2 * 1.96 * 0.02, rel=1e-3)
    # Nominal values are 10, 5, 10 and 1 % off, half widths 3.9 %; the lines are 17, 3, 10 and 1 % above nominal.
    covered = [row["covered"] for row in rows["paper"].values()]
    assert covered == ["neither", "line", "neither", "nominal and line"]


def test_pathology_and_treatment_are_predicted_as_measured(study, nominal):
    assert nominal[PATHOLOGY].predicted.events
    assert nominal[PATHOLOGY].measured.events
    assert nominal[PATHOLOGY].predicted.re_engaged is False
    assert not nominal[TREATMENT].predicted.events
    assert not nominal[TREATMENT].measured.events
    assert all(run.as_measured for run in nominal.values())
    rows = list(outcome_rows(study))
    assert [row["as_measured"] for row in rows] == 2 * [None, True, True, True, True]
    begins = [row["text"].split(" at ")[0] for row in rows]
    assert begins == 5 * ["lateral dislocation"] + 5 * ["normal tracking"]


def test_a_wrong_outcome_is_called_wrong(study, nominal):
    times = np.linspace(0.0, 1.0, 101)
    never, stays = find_dislocations(times, 0 * times), find_dislocations(times, np.where(times > 0.5, 0.03, 0.0))
    returns = find_dislocations(times, np.where((times > 0.3) & (times < 0.6), 0.03, 0.0))
    outcomes = (never, stays, returns)
    run = nominal[PATHOLOGY]
    same = [[run._replace(predicted=a, measured=b).as_measured for b in outcomes] for a in outcomes]
    assert same == np.eye(3, dtype=bool).tolist()
    wrong = nominal[PATHOLOGY]._replace(predicted=nominal[TREATMENT].predicted)
    runs = study.runs | {"paper": {**study.runs["paper"], PATHOLOGY: wrong}}
    rows = list(outcome_rows(replace(study, runs=runs)))
    assert [row["as_measured"] for row in rows[:3]] == [None, False, True]


def test_the_paths_errors_are_the_papers_objective(nominal):
    for run in nominal.values():
        off = 1e3 * (run.result.center - rig.measured(run.case).center)
        assert paper_objective(run) == pytest.approx(np.sqrt(np.mean(off**2, axis=0)).sum())


def test_a_fit_that_did_not_converge_is_said_to(study):
    assert len(list(notes(study))) == 3
    stuck = replace(study.fits["paper"], reason="iterations ran out", values=1.3 * PUBLISHED)
    last = list(notes(replace(study, fits=study.fits | {"paper": stuck})))[3]
    assert "iterations ran out; at a bound: K1, L1, K2, L2" in last


def test_files(study, tmp_path):
    written = save(study, tmp_path)
    assert {p.name for p in written} == {p.name for p in tmp_path.iterdir()}
    assert all(p.stat().st_size > 100 for p in written)
    rows = list(csv.DictReader((tmp_path / "table2.csv").open()))
    distance = next(r for r in rows if r["row"] == "mean distance")
    shown = [distance[f"case1_{what}"] for what in (*(f"by_{fit}" for fit in FITS), "published")]
    assert shown == ["10", "11", "12", "2.61"]
    assert len(rows) == 4 + 1 + 12
    springs = list(csv.DictReader((tmp_path / "springs.csv").open()))
    assert [(r["fit"], r["name"]) for r in springs] == [(f, n) for f in FITS for n in ("K1", "L1", "K2", "L2")]
    assert Estimate.load(tmp_path / "fit.json").objective == "paper"
    assert Estimate.load(tmp_path / "fit_force.json").values == pytest.approx(study.fits["force"].values)


def test_facts_say_that_the_measurements_are_synthetic(study):
    plain = facts(study)
    assert plain["synthetic"] is True
    assert {row["row"]: row["case1_by_paper"] for row in plain["table2"]}["mean distance"] == 10.0
    assert plain["springs"]["paper"][0]["paper_error"] == 8.0
    assert len(plain["outcomes"]) == 10
    assert plain["runs"][NOMINAL][TREATMENT] == status_facts(study.runs[NOMINAL][TREATMENT].result.flags)


def test_the_commands_tables_have_a_cell_for_every_heading(study):
    sheets = [*(_table_2(study, n) for n in CASES), *(_springs(study, fit) for fit in FITS), _outcomes(study)]
    every = [f"{row['row']}, {row['unit']}" for row in table_2(study)]
    assert [row[0] for row in sheets[0].rows] == every  # of the case that was fitted
    assert [row[0] for row in sheets[1].rows] == every[5:]  # without errors of springs and times of fits
    for sheet in sheets:
        assert sheet.rows
        assert all(len(row) == len(sheet.headings) for row in sheet.rows)
    assert all("SYNTHETIC" in sheet.title for sheet in sheets[:-1])
    assert dict(zip(sheets[1].headings, sheets[1].rows[every[5:].index("mean distance, mm")], strict=True)) == {
        "": "mean distance, mm", "A": "10", "B": "11", "C": "12", "paper": "2.61"
    }  # fmt: skip
