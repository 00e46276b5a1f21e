"""`pftwin treat`: from a scene and an estimate to a table, a NetCDF file, JSON and a figure."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from made_estimates import made_estimate
from typer.testing import CliRunner

from fitting.cli.amounts import AMOUNTS
from fitting.coverage import QUICK
from fitting.parameters import REQUESTED
from fitting.prediction.band_sources import band_sources
from fitting.prediction.plots import outcome_sheet
from pftwin.base.errors import InputError
from pftwin.base.written_amounts import several_amounts
from pftwin.cli import app
from pftwin.cli.terminal import show
from pftwin.files.result_files import load_dataset
from pftwin.model.measured import SYNTHETIC

RUNNER = CliRunner(env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    """An estimate of case 2's stiffness K1 and slack length L2, as `pftwin fit` writes it."""
    path = tmp_path_factory.mktemp("fit") / "fit.json"
    return made_estimate({"K1": (157.0, 2.0), "L2": (0.0713, 2e-4)}, kinds=(REQUESTED, "friction")).save(path)


@pytest.fixture(scope="module")
def treated(fit, tmp_path_factory):
    folder = tmp_path_factory.mktemp("treated")
    command = ["treat", "--case", "2", "--estimate", str(fit), "--tto-medial", "0:16:8", "--samples", "8"]
    outcome = RUNNER.invoke(
        app, [*command, "--dt", "0.001", "-o", str(folder / "v.nc"), "--json", str(folder / "v.json")]
    )
    assert outcome.exit_code == 0, outcome.output
    return outcome, folder


def test_table_says_from_where_on_nothing_dislocates(treated):
    outcome, _ = treated
    assert "without dislocation from 8 mm of tibial tuberosity transfer medialisation on" in outcome.stdout
    assert "medialisation [mm]" in outcome.stdout
    assert "100 % of draws" in outcome.stdout
    assert "bands would be narrower by [%]" in outcome.stdout
    assert "requested parameters" in outcome.stdout
    assert SYNTHETIC in outcome.stdout
    assert "estimated from synthetic measurements" in outcome.stdout
    assert f"in brackets: 95 % interval over the draws, without those that failed; {QUICK.bands}" in outcome.stdout


def test_the_table_is_whole_at_80_columns(treated, capsys, monkeypatch):
    """Outcomes with their bands take more: they go on below, again with the amount."""
    monkeypatch.setenv("COLUMNS", "80")
    sheet = outcome_sheet(load_dataset(treated[1] / "v.nc"), 40)
    show(sheet)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines()[: -len(sheet.notes)])) <= 80
    for cell in (cell for row in sheet.rows for cell in row):
        assert cell in shown
    assert {word for heading in sheet.headings for word in heading.split()} <= set(shown.split())
    assert shown.count("medialisation") > 1


@pytest.mark.slow
def test_what_follows_from_doubted_measurements_is_flagged(tmp_path):
    doubted = made_estimate({"K1": (157.0, 2.0)}, doubts=["measured position is 30 ms late"])
    command = ["treat", "--case", "2", "--estimate", str(doubted.save(tmp_path / "fit.json")), "--tto-medial", "0:16:8"]
    outcome = RUNNER.invoke(app, [*command, "--samples", "4", "-o", str(tmp_path / "v.nc")])
    assert outcome.exit_code == 3
    assert outcome.stdout.startswith("INVALID: measured position is 30 ms late")
    assert "INVALID estimate: measured position is 30 ms late" in outcome.stdout
    assert not re.search(r"without dislocation|no variant|dislocates", outcome.stdout)
    assert "flagged: INVALID: measured position is 30 ms late" in outcome.stderr


def test_files_hold_the_outcomes(treated):
    _, folder = treated
    data = load_dataset(folder / "v.nc")
    np.testing.assert_allclose(data["tibial_tuberosity_transfer_medialisation"], [0, 0.008, 0.016])
    assert data.sizes["sample"] == 9
    np.testing.assert_array_equal(data["dislocations"].values[:, 0], [1, 0, 0])
    np.testing.assert_allclose(data["parameters"].values[0], [157.0, 0.0713])
    plain = json.loads((folder / "v.json").read_text())
    assert plain["variants"][1]["largest_offset"] == pytest.approx(float(data["largest_offset"][1, 0]))
    assert plain["units"]["largest_offset"] == "m"
    assert plain["coverage"] == QUICK.bands
    for i, variant in enumerate(plain["variants"]):  # the estimate's own, not a draw's
        assert list(variant["status_frames"].values()) == data["status_frames"].values[i, 0].tolist()
        assert variant["status_frames"]["left_patch"] == int(data["status_frames"].sel(flag="left_patch")[i, 0])
        assert ("outside the fitted surface" in variant["status"]) == (variant["status_frames"]["left_patch"] > 0)
    low, high = plain["bands_95"]["largest_offset"]
    assert low[1] <= plain["variants"][1]["largest_offset"] <= high[1]
    assert (folder / "v.png").stat().st_size > 10_000
    svg = (folder / "v.svg").read_text()
    assert "synthetic" in svg
    assert "95 % of 8 draws" in svg
    assert plain["bands_narrower_if_known"] == band_sources(data).facts()
    assert plain["bands_narrower_if_known"]["friction"]["largest_offset"] is not None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:20:5", [0, 5, 10, 15, 20]),
        ("0:1:0.1", np.arange(11) / 10),
        ("5", [5]),
        ("0,-3", [0, -3]),
        ("2:4", [2, 3, 4]),
    ],
)
def test_ranges_include_their_end(text, expected):
    np.testing.assert_allclose(several_amounts(text, "--tto-medial"), expected)


@pytest.mark.parametrize("text", ["0:20:5 mm", "0:2:0.5 cm", "0:0.02:0.005 m", "0 mm:2 cm:5 mm", "0,5,10,15,20 mm"])
def test_ranges_may_have_units(text):
    np.testing.assert_allclose(several_amounts(text, "--tto-medial", "mm"), [0, 5, 10, 15, 20], atol=1e-12)
    with pytest.raises(InputError, match="--angle"):
        several_amounts(text, "--angle", "deg")


def test_options_keep_their_former_names_and_show_those_of_surgeons(monkeypatch):
    combined = []
    monkeypatch.setattr("fitting.prediction.variants.combinations", lambda numbers: combined.append(numbers) or 1 / 0)
    pairs = {a.former: a.flag for a in AMOUNTS if a.former}
    assert pairs["--medialise"] == "--tto-medial"
    assert pairs["--distalise"] == "--tto-distal"
    commands = ("simulate", "treat", "optimise", "calibrate")
    shown = [RUNNER.invoke(app, [command, "--help"]).stdout.split() for command in commands]
    for former, flag in pairs.items():
        for name in (former, flag):
            outcome = RUNNER.invoke(app, ["treat", "--case", "2", name, "0:2", "-o", "v.nc"])
            assert isinstance(outcome.exception, ZeroDivisionError), outcome.output
        assert combined[-1] == combined[-2]
        assert all(flag in words and former not in words for words in shown)
    assert combined[1] == {"tibial_tuberosity_transfer": {"medialisation": [0.0, 1.0, 2.0]}}
    both = ["treat", "--case", "2", "--medialise", "1", "--tto-medial", "2", "-o", "v.nc"]
    outcome = RUNNER.invoke(app, both)
    assert outcome.exit_code == 2
    assert "--medialise and --tto-medial given; expected: one of them" in outcome.stderr


@pytest.mark.parametrize("text", ["", "a", "0:20:0", "20:0:1", "0:1:2:3", "nan", "0:inf:1", "0:1e9:1"])
def test_ranges_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="--tto-medial"):
        several_amounts(text, "--tto-medial")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--case", "2"], "no treatment given"),
        (["--case", "2", "--tighten-mpfl", "1"], "no tendon or strands named 'mpfl'"),
        (["--case", "2", "--contact", "P2", "--trochleoplasty", "2"], "expected: degree 4 or more"),
        (["--case", "2", "--tto-medial", "0:1000:0.01", "--tto-distal", "0:99:1"], "combinations"),
        (["--case", "2", "--tto-medial", "1", "--estimate", "nothing.json"], "nothing.json: no such file"),
        (["--tto-medial", "1"], "neither a scene file nor --case"),
    ],
)
def test_mistakes_are_one_line(arguments, message, tmp_path):
    outcome = RUNNER.invoke(app, ["treat", *arguments, "-o", str(tmp_path / "v.nc")])
    assert outcome.exit_code == 2
    assert message in " ".join(outcome.stderr.split())
    assert not list(tmp_path.iterdir())


def test_results_are_netcdf(tmp_path):
    outcome = RUNNER.invoke(app, ["treat", "--case", "2", "--tto-medial", "1", "-o", str(tmp_path / "v.csv")])
    assert outcome.exit_code == 2
    assert "v.nc" in outcome.stderr


@pytest.mark.slow
def test_a_simulation_after_a_treatment(tmp_path):
    """What dislocates as it is does not with the tuberosity 16 mm medial; the result says what was done."""
    out = tmp_path / "after.nc"
    outcome = RUNNER.invoke(app, ["simulate", "--case", "2", "--tto-medial", "16", "-o", str(out)])
    assert outcome.exit_code == 0, outcome.output
    data = load_dataset(out)
    assert data.attrs["scene"] == "rig case 2, P5, tto-medial 16 mm"
    assert data.attrs["tracking"] == "normal tracking"
    assert "synthetic" in data.attrs["note"]


@pytest.mark.parametrize("amount", ["0:16:8", "a little", "16 N"])
def test_a_simulation_takes_one_value_of_each_amount(amount, tmp_path):
    outcome = RUNNER.invoke(app, ["simulate", "--case", "2", "--tto-medial", amount, "-o", str(tmp_path / "x.nc")])
    assert outcome.exit_code == 2
    assert "--tto-medial" in outcome.stderr
    assert not (tmp_path / "x.nc").exists()
