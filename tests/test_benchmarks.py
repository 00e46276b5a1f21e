"""The benchmark command: what it measures it measures right, and its report says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from tests.benchmarks import accuracy, extrapolation
from tests.benchmarks.__main__ import app
from tests.benchmarks.clock import Times, measure
from tests.benchmarks.report import from_json, markdown, to_json
from tests.benchmarks.row import Row

RUNNER = CliRunner()
MACHINE = {"cpu": "some", "cores": 2, "dtype": "float64", "jax": "0", "date": "2026-01-01T00:00"}


def test_the_coarsest_step_that_meets_a_level_is_found():
    errors = {50: np.array([1e-6]), 20: np.array([4e-6]), 10: np.array([2e-5]), 5: np.array([9e-6])}
    assert accuracy.coarsest(errors, 1e-5) == 20  # that 5 does so too is luck: 10 does not
    assert accuracy.coarsest(errors, 1e-7) is None
    assert accuracy.coarsest({5: np.array([np.nan])}, 1e-5) is None


def test_speed_is_measured_with_the_fewest_steps_that_meet_a_level():
    first, second = ({10: np.array([e]), 5: np.array([10 * e]), 2: np.array([40 * e])} for e in (1e-6, 5e-7))
    found = {"linear_implicit": first, "linear_implicit_bdf2": second}
    assert accuracy.cheapest(found, 1e-5) == ("linear_implicit", 5)  # of equal steps the first
    assert accuracy.cheapest(found, 2e-5) == ("linear_implicit_bdf2", 2)
    assert accuracy.cheapest(found, 1e-7) is None


def test_rms_is_over_frames():
    assert accuracy.rms(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))


def test_cold_and_warm_calls_are_timed_separately():
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


COSTS = extrapolation.Costs(10.0, call=0.1, steps=1e-3, host=1e-5, written=(0.04, 5e-6), read=(0.01, 4e-6))


def test_one_device_spends_its_time_on_steps():
    share = extrapolation.share_of(COSTS, 120_000, 1, 1)
    assert share.largest == "steps"
    assert share.steps == pytest.approx(120.0)
    assert share.host == pytest.approx(1.2)
    assert share.start == pytest.approx(10.1)
    assert share.written == pytest.approx(63 * 0.04 + 0.6)
    assert share.read == pytest.approx(63 * 0.01 + 0.48)


def test_more_processes_share_out_steps_and_no_reading():
    alone, many = (extrapolation.share_of(COSTS, 10_000_000, n, 32) for n in (1, 64))
    assert many.read == alone.read
    assert many.start == alone.start
    for name in ("steps", "host", "written"):  # the slowest has at most a part more than its share
        assert getattr(alone, name) / 64 < getattr(many, name) < 1.5 * getattr(alone, name) / 64
    assert many.largest == "read"


def test_a_process_has_whole_parts_and_a_device_whole_pieces():
    """Two parts on three processes take as long as on two; a device beyond the pieces gains nothing."""
    two, three = (extrapolation.share_of(COSTS, 3_840, n, 1) for n in (2, 3))
    assert two.steps == three.steps == pytest.approx(1.92)
    assert extrapolation.share_of(COSTS, 1_920, 1, 16).steps == pytest.approx(0.12)
    assert extrapolation.share_of(COSTS, 1_920, 1, 64).steps == pytest.approx(0.12)


def test_constants_are_taken_from_the_rows():
    def of_size(count: int, devices: int = 1) -> Row:
        programs = 1e-3 * count / devices
        details = {"devices": devices, "members": count, "outside_s": 0.1 + 1e-5 * count, "programs_s": programs}
        return Row("scaling", f"{count} variants, {devices} devices: time per variant", 1.0, "ms", details=details)

    rows = [*map(of_size, (16, 1_000, 100)), of_size(10**6, 2), Row("scaling", "start, programs kept", 10, "s")]
    for part in (1_000, 3_000):
        for what, ms in (("written", 40 + 5e-3 * part), ("read", 10 + 3e-3 * part), ("joined", 1e-3 * part)):
            rows.append(Row("scaling", f"a part of {part:,} variants: {what}", ms, "ms", details={"part": part}))
    found = extrapolation.costs_of(rows)
    assert found.call == pytest.approx(0.10016)
    for name in ("start", "steps", "host", "written", "read"):
        assert getattr(found, name) == pytest.approx(getattr(COSTS, name)), name
    assert extrapolation.serial_fraction(found) == pytest.approx(0.01 / 1.01)
    text = extrapolation.markdown(found)
    assert "| **serial fraction** of one process | **0.99 %** |" in text
    assert "| 1,000,000 | 4 x 32 |" in text
    with pytest.raises(InputError, match="no parts of two sizes"):
        extrapolation.costs_of(rows[:5])
    with pytest.raises(InputError, match="no row"):
        extrapolation.costs_of(rows[:4])


def test_the_page_follows_from_the_stored_figures(tmp_path):
    root = Path(__file__).resolve().parents[1]
    newest = max((root / "docs" / "benchmarks").glob("scaling-*.json"))
    answer = RUNNER.invoke(extrapolation.app, [str(newest)])
    assert answer.exit_code == 0, answer.output
    for table in answer.output.strip().split("\n\n"):
        assert table in (root / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    answer = RUNNER.invoke(extrapolation.app, [str(tmp_path / "none.json")])
    assert answer.exit_code == 2
    assert "cannot be read" in answer.output
