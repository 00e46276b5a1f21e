"""The benchmark command: what it measures it measures right, and its report says so."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from pftwin.benchmarks import accuracy
from pftwin.benchmarks.__main__ import app
from pftwin.benchmarks.clock import Times, measure
from pftwin.benchmarks.report import from_json, markdown, to_json
from pftwin.benchmarks.row import Row

RUNNER = CliRunner()
MACHINE = {"cpu": "some", "cores": 2, "dtype": "float64", "jax": "0", "date": "2026-01-01T00:00"}


def test_the_coarsest_step_that_meets_a_level_is_found():
    errors = {50: np.array([1e-6]), 20: np.array([4e-6]), 10: np.array([2e-5]), 5: np.array([9e-6])}
    assert accuracy.coarsest(errors, 1e-5) == 20  # that 5 does so too is luck: 10 does not
    assert accuracy.coarsest(errors, 1e-7) is None
    assert accuracy.coarsest({5: np.array([np.nan])}, 1e-5) is None


def test_rms_is_over_frames():
    assert accuracy.rms(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))


def test_cold_and_warm_calls_are_kept_apart():
    calls = []
    times = measure(lambda: calls.append(1), runs=3, seconds=0.0)
    assert len(times.warm) == 3
    assert len(calls) == 4
    assert Times(9.0, (1.0, 5.0, 2.0)).median == 2.0


@pytest.mark.parametrize(("measured", "sense", "met"), [(3.0, "at least", True), (1.0, "at least", False),
                                                        (3.0, "at most", False), (1.0, "at most", True)])  # fmt: skip
def test_a_target_is_met_or_not(measured, sense, met):
    row = Row("one run", "what", measured, "x", 2.0, sense)
    assert row.passed is met
    assert ("not met" in markdown([row], MACHINE)) is not met


def test_json_there_and_back(tmp_path):
    rows = [Row("batch", "what", 1.5, "ms", None, note="how", details={"runs": 3})]
    file = tmp_path / "b.json"
    file.write_text(to_json(rows, MACHINE))
    again, machine = from_json(file)
    assert again == rows
    assert machine["cpu"] == "some"


def test_an_unknown_topic_is_refused_with_the_known_ones():
    answer = RUNNER.invoke(app, ["--only", "speed"])
    assert answer.exit_code == 2
    assert "one run" in answer.output


@pytest.mark.slow
def test_a_quick_run_of_one_topic(tmp_path):
    out = tmp_path / "b.json"
    answer = RUNNER.invoke(app, ["--only", "equilibrium", "--quick", "--out", str(out)])
    assert answer.exit_code == 0, answer.output
    rows = json.loads(out.read_text())["rows"]
    assert all(row["value"] > 0 for row in rows)
