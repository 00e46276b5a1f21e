"""`pftwin optimise`: from limits and ranges to a plan in words and in JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from made_estimates import made_estimate
from toy_scene_files import write_toy
from typer.testing import CliRunner, Result

from fitting.cli.amounts import limits
from fitting.prediction.outcomes import MEASURES
from fitting.treatments.limits import NO_NUMBER, Limit
from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.cli.exit_codes import ExitCode

SOUND = ["--limit", "dislocation_margin>=3 mm", "--tto-medial", "0:20"]


def pftwin(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def fit(toy: Path) -> Path:
    """An estimate of K1, as `pftwin fit` writes it."""
    more = {"objective": "likelihood", "objective_unit": "nats", "noise": {"position": 1e-4}, "scene_name": "toy"}
    return made_estimate({"K1": (156.0, 2.0)}, source="a toy", **more).save(toy.parent / "fit.json")


@pytest.mark.slow
def test_a_plan_with_its_sureness(toy, fit, tmp_path):
    output = tmp_path / "plan.json"
    given = ["--limit", "peak_contact_force<=1e6 N", "--limit", "dislocation_margin >= -1 m", "--tto-medial", "-4:4"]
    result = pftwin("optimise", toy, "--estimate", fit, *given, "--samples", 5, "-o", output, "--json", "-")
    assert result.exit_code == 0, result.output
    plan = json.loads(output.read_text())
    assert plan == json.loads(result.stdout)
    assert plan["met"]
    assert plan["amounts"] == {"tibial_tuberosity_transfer.medialisation": {"value": 0.0, "unit": "m"}}
    assert plan["share_of_draws"] == 1
    assert plan["samples"] == 5
    assert [x["holds"] for x in plan["limits"]] == [True, True]
    assert plan["notes"] == ["the parameters were estimated from synthetic measurements"]
    assert "all limits are met in 100% of 5 draws" in " ".join(result.stderr.split())
    assert "peak contact force at most 1e+06 N" in result.stderr


@pytest.mark.slow
def test_a_plan_from_doubted_measurements_concludes_nothing(toy, tmp_path):
    fit = made_estimate({"K1": (156.0, 2.0)}, doubts=["measured position is 30 ms late"]).save(tmp_path / "fit.json")
    given = ["--limit", "peak_contact_force<=1e6 N", "--tto-medial", "-4:4", "--json", tmp_path / "plan.json"]
    result = pftwin("optimise", toy, "--estimate", fit, *given)
    assert result.exit_code == ExitCode.FLAGGED, result.output
    assert result.stdout.startswith("INVALID: measured position is 30 ms late")
    assert "meets the limits" not in result.output
    plan = json.loads((tmp_path / "plan.json").read_text())
    assert plan["verdict"] == plan["sentence"]
    assert plan["verdict"].startswith("INVALID")
    assert not plan["met"]
    assert not any(limit["holds"] for limit in plan["limits"])


@pytest.mark.slow
def test_what_cannot_be_met_is_said(toy):
    """Compiles without an estimate what the plan above has compiled with one; in Python: test_optimise."""
    result = pftwin("optimise", toy, "--limit", "peak_contact_force<=1e-6 N", "--tto-medial", "0:4")
    assert result.exit_code == ExitCode.FLAGGED, result.output
    assert "no amount within the range meets the limits" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (SOUND[:2], "no treatment given"),
        (["--limit", "dislocation_margin>=3", "--tto-medial", "0:20"], "dislocation_margin in mm or cm or m"),
        (["--limit", "pain<=3", "--tto-medial", "0:20"], "dislocation_margin [mm], mean_tilt [deg]"),
        (
            [*SOUND[:2], "--tto-medial", "20:0"],
            "--tto-medial: found '20:0'; expected: FROM:TO",
        ),
        ([*SOUND[:2], "--tto-medial", "0:20:1"], "FROM:TO, such as 0:20"),
        (
            [*SOUND, "--samples", "5"],
            "samples without an estimate",
        ),
        ([*SOUND, "--confidence", "90"], "confidence: found 90"),
        ([*SOUND, "--estimate", "no.json"], "no such file"),
    ],
)
def test_mistakes_are_one_line(toy, arguments, message, tmp_path):
    result = pftwin("optimise", toy, *arguments, "-o", tmp_path / "plan.json")
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("command", "option"), [("optimise", "--limit"), ("calibrate", "--meet")])
def test_limits_are_listed_with_their_units(command, option):
    """Without all else that the command needs; each unit that is listed is taken, with the size that it has."""
    result = pftwin(command, option, "help")
    assert result.exit_code == 0, result.output
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in result.stdout.splitlines()]
    listed = {row[0]: row[1].split(", ") for row in rows if row[0] in MEASURES}
    assert set(listed) == set(MEASURES) - set(NO_NUMBER)
    assert {name for name, units in listed.items() if units == ["number"]} == {
        "dislocations",
        "dislocation_side",
        "tracks_at_end",
    }
    sizes = {"mm": 1e-3, "cm": 1e-2, "m": 1, "um": 1e-6, "deg": math.pi / 180, "rad": 1, "N": 1, "mN": 1e-3, "%": 0.01}
    for name, units in listed.items():
        for unit in units:
            plain = unit == "number"
            limit = Limit.parsed(f"{name}<=2{'' if plain else unit}")
            assert limit.at_most == pytest.approx(2 * (1 if plain else sizes[unit]))


def test_limits_are_listed_with_their_units_unbroken_at_80_columns():
    listed = CliRunner().invoke(app, ["optimise", "--limit", "help"], env={"COLUMNS": "80"}).stdout.splitlines()
    assert max(map(len, listed)) <= 80
    assert any("mm, cm, m, um" in line for line in listed)
    assert any("number, %" in line for line in listed)


def test_ranges_may_have_units():
    assert limits("0:2 cm", "--tto-medial", "mm") == (0, 20)
    assert limits("-5:20", "--tto-medial", "mm") == (-5, 20)


@pytest.mark.parametrize("text", ["", "a:b", "1", "0:1:2", "nan:1", "1:1"])
def test_ranges_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="--tto-medial"):
        limits(text, "--tto-medial", "mm")
