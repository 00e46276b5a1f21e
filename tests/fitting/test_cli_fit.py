"""`pftwin fit` and `pftwin plan-experiment`: what they write, say and refuse."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from toy_scene_files import LIGHT, START, fixed_poses, tibia_poses, write_poses
from typer.testing import CliRunner, Result

from fitting import Estimate
from pftwin import load_scene, simulate
from pftwin.cli import app
from pftwin.dynamics.status import FLAGS, status_facts
from pftwin.files.mocap import PoseSeries

MEASURED = """
[measured]
patella = { body = "patella" }
"""


def pftwin(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


def refused(*arguments: object) -> str:
    result = pftwin(*arguments)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    return result.stderr


def files_of(folder: Path, tibia: PoseSeries, text: str = LIGHT + MEASURED) -> Path:
    """The scene file of a knee without a mesh, whose patella was measured not to move."""
    write_poses(folder / "poses.csv", {"tibia": tibia, "patella": fixed_poses(tibia, *START)})
    scene = folder / "scene.toml"
    scene.write_text(text)
    return scene


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of frames so close that a fit's search and its answer take the same steps."""
    return files_of(tmp_path_factory.mktemp("toy"), tibia_poses(121, rate=600))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of as many frames as other tests simulate of this knee: by the same program."""
    return files_of(tmp_path_factory.mktemp("plain"), tibia_poses())


def test_names_that_are_separated_by_spaces_are_refused_as_such(plain, tmp_path):
    """The second name is then where a scene file is expected."""
    for scene in ((plain,), ("--case", 2)):
        message = refused("fit", *scene, "-o", tmp_path / "fit.json", "--free", "K1", "L1")
        assert "L1: no such file; expected: a scene file; try: names are separated by commas: --free K1,L1" in message
    missing = refused("fit", "walk.toml", "-o", tmp_path / "fit.json")
    assert "walk.toml: no such file; try: check the path" in missing


def test_fit_writes_an_estimate_with_figures(plain, tmp_path):
    output = tmp_path / "fit.json"
    result = pftwin("fit", plain, "-o", output, "--free", "K1,L1", "--starts", 2, "--json", "-")
    assert result.exit_code == 0, result.output
    printed, written = json.loads(result.stdout), json.loads(output.read_text())
    assert {k: printed[k] for k in written} == written
    assert written["names"] == ["K1", "L1"]
    assert "positions give" in written["sentence"]
    assert {Path(p).name for p in printed["files"]} == {"fit.json"} | {
        f"fit_{what}.{kind}" for what in ("fit", "correlation", "history") for kind in ("png", "svg")
    }
    assert all(Path(p).stat().st_size > 1000 for p in printed["files"])
    assert "95 % interval" in result.stderr
    assert sum(written["status_frames"].values()) == 0 or written["status"] != "ok"
    assert list(written["status_frames"]) == [str(flag.name).lower() for flag in FLAGS]  # of the fitted motion
    flags = simulate(Estimate.load(output).apply(load_scene(plain))).flags
    assert {k: written[k] for k in ("status", "status_frames")} == status_facts(flags)


def test_a_fit_to_doubted_measurements_is_written_and_flagged(plain, tmp_path):
    """The toy's patella was "measured" not to move, which its springs cannot do to 0.1 mm."""
    output = tmp_path / "fit.json"
    options = ("--free", "K1,L1", "--starts", 2, "--no-figures", "--limit", "position=1e-4:1")
    result = pftwin("fit", plain, "-o", output, *options)
    assert result.exit_code == 3, result.output
    assert result.stdout.startswith("INVALID: residual of position: ")
    table = [line for line in result.stdout.splitlines() if line.startswith("│")]
    assert [line.split()[1] for line in table if "at its bound" not in line] == ["K1", "L1"]
    assert "at its bound" in table[1]  # below the value of K1, as the sentence names it
    assert "flagged: INVALID: residual of position: " in result.stderr
    assert json.loads(output.read_text())["doubts"][0].startswith("residual of position: ")


@pytest.mark.slow
def test_fit_with_a_posterior(toy, tmp_path):
    output = tmp_path / "fit.json"
    options = ["--free", "L1", "--starts", 2, "--posterior", 8, "--json", "-", "--noise", "position=1e-3"]
    result = pftwin("fit", toy, "-o", output, *options)
    assert result.exit_code == 0, result.output
    printed, written = json.loads(result.stdout), json.loads(output.read_text())
    assert written["posterior"] == printed["posterior"]
    assert printed["posterior"]["names"] == ["L1"]
    assert printed["posterior"]["chains"] == 4
    assert printed["posterior"]["draws"] == 8
    assert str(tmp_path / "fit_posterior.png") in printed["files"]
    assert printed["posterior"]["sentence"] in " ".join(result.stderr.split())
    assert Estimate.load(output).names == ("L1",)


@pytest.mark.slow
def test_plan_experiment_says_what_helps(toy):
    result = pftwin("plan-experiment", toy, "--free", "K1,L1", "--noise", "position=1e-4", "--json", "-")
    assert result.exit_code == 0, result.output
    plan = json.loads(result.stdout)
    assert plan["noise"]["position"] == 1e-4
    assert plan["sentence"].startswith("at best, ")
    for name in ("orientation", "contact"):
        assert all(a <= b for a, b in zip(plan["additions"][name], plan["relative_standard_deviations"], strict=True))


def test_mistakes_at_the_command_line(toy, tmp_path):
    assert "estimates are JSON" in refused("fit", toy, "-o", tmp_path / "fit.nc")
    assert "such as" in refused("fit", toy, "-o", tmp_path / "fit.json", "--free", "quadricep.stifness")
    assert "no method" in refused("fit", toy, "-o", tmp_path / "fit.json", "--method", "simplex")
    assert 'such as "position=0.2 mm"' in refused("fit", toy, "-o", tmp_path / "fit.json", "--noise", "small")
    paper = refused("fit", toy, "-o", tmp_path / "fit.json", "--posterior", 10, "--objective", "paper")
    assert "no likelihood" in paper
    assert "nothing to resume" in refused("fit", toy, "-o", tmp_path / "fit.json", "--resume")
    assert 'such as "force=0.2:0.8"' in refused("fit", toy, "-o", tmp_path / "fit.json", "--limit", "force=0.2")
    assert "no limit 'forces'" in refused("fit", toy, "-o", tmp_path / "fit.json", "--limit", "forces=0.2:0.8")
    for bounds in ("K1=", "=1:2", "K1=1", "wide"):
        assert "each once" in refused("fit", toy, "-o", tmp_path / "fit.json", "--bounds", bounds)
    for option, value in (("--bounds", "K1=100:200"), ("--limit", "force=0.2:0.8")):
        twice = refused("fit", toy, "-o", tmp_path / "fit.json", *2 * (option, value))
        assert f"{option}: {value.split('=')[0]!r} is given twice" in twice
    readings = refused("calibrate", toy, "-o", tmp_path / "c.json", "--method", "least_squares", "--reading-noise", "a")
    assert "--reading-noise: found 'a'" in readings
    for option, text in (("--marker-noise", "0.2 N"), ("--force-noise", "-1 N"), ("--force-noise", "1 mm")):
        assert f"{option}: found {text!r}" in refused("calibrate", toy, "-o", tmp_path / "c.json", option, text)
    assert 'such as "0:0.5"' in refused("fit", toy, "-o", tmp_path / "fit.json", "--during", "0.5")
    assert "spans of the recording" in refused("fit", toy, "-o", tmp_path / "fit.json", "--during", "7:8")
    assert "FROM:TO" in refused("fit", toy, "-o", tmp_path / "fit.json", "--during", "0.1:0.05")
    assert "no channel" in refused("plan-experiment", toy, "--use", "magic")
    assert not list(tmp_path.iterdir())


def test_a_scene_without_measurements(tmp_path):
    scene = files_of(tmp_path, tibia_poses(), LIGHT)
    assert "nothing to compare with" in refused("fit", scene, "-o", tmp_path / "fit.json")


def test_what_is_no_nuisance_is_refused_before_anything_is_compiled(toy, tmp_path):
    for command in (("fit", toy, "-o", tmp_path / "fit.json"), ("plan-experiment", toy)):
        said = refused(*command, "--nuisance", "friction")
        assert "nuisance: found 'friction'" in said
        assert "rig, mocap, mri" in said


def test_trials_are_of_one_kind_and_each_is_named_once(toy, tmp_path):
    output = tmp_path / "fit.json"
    assert "both scene files and --case given" in refused("fit", toy, "--case", 2, "-o", output)
    assert f"{toy} is named twice" in refused("fit", toy, toy, "-o", output)
    assert "2 is named twice" in refused("plan-experiment", "--case", 2, "--case", 2)


@pytest.mark.slow
def test_two_trials_are_fitted_and_planned(toy, tmp_path):
    other = files_of(tmp_path, tibia_poses(61, rate=300))
    output = tmp_path / "fit.json"
    apart = ("--free", "K1,L1", "--starts", 2, "--varies", "L1=1e-3")
    result = pftwin("fit", toy, other, "-o", output, *apart, "--json", "-")
    assert result.exit_code in (0, 3), result.output
    written = json.loads(output.read_text())
    assert len(written["trial_rmse"]) == 2
    assert list(written["in_trials"]["L1"]) == list(written["trial_rmse"])
    assert {"fit_fit.png", "fit_fit_2.png"} <= {Path(p).name for p in json.loads(result.stdout)["files"]}
    planned = pftwin("plan-experiment", toy, other, "--free", "K1,L1", "--json", "-")
    assert planned.exit_code == 0, planned.output
    (trial,) = json.loads(planned.stdout)["trials"]
    assert trial in json.loads(planned.stdout)["additions"]


@pytest.mark.parametrize(
    ("options", "named"), [(["--use", "position,orientation"], "--use"), (["--bounds", 0.4, "--starts", 3], "--starts")]
)
def test_settings_fixed_in_training_are_refused(toy, tmp_path, options, named):
    said = refused("fit", toy, "-o", tmp_path / "fit.json", "--trained", tmp_path / "knee.npz", *options)
    assert "together with this file; expected: none, as the file has fixed them" in said
    assert named in said


def test_a_trained_posterior_has_its_suffix(toy, tmp_path):
    assert "try: " in refused("train-posterior", toy, "-o", tmp_path / "knee.json")


@pytest.mark.slow
def test_a_posterior_is_trained_once_and_answers(toy, tmp_path):
    trained, output = tmp_path / "knee.npz", tmp_path / "fit.json"
    options = ("--free", "K1,L1", "--noise", "position=1e-3", "--limit", "position=0.1:1")
    result = pftwin("train-posterior", toy, "-o", trained, *options[:4], "--simulations", 2000, "--json", "-")
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert (printed["free"], printed["frames"], printed["simulations"]) == (["K1", "L1"], [121], 2000)
    assert "answers recordings of 121 frames" in result.stderr
    result = pftwin("fit", toy, "-o", output, "--trained", trained, *options[4:], "--no-figures")
    assert result.exit_code in (0, 3), result.output
    written = json.loads(output.read_text())
    assert written["names"] == ["K1", "L1"]
    assert "a posterior trained by" in written["reason"]
    assert len(written["draws"]) == 2000
    calibration = tmp_path / "calibration.json"
    options = ("--plants", 3, "--kinds", "misplaced,stiffening", "--cutoff", 0, "--seed", 3)
    result = pftwin("calibrate", toy, "--trained", trained, "-o", calibration, *options)
    assert result.exit_code in (0, 3), result.output
    written = json.loads(calibration.read_text())
    assert list(written["kinds"]) == ["misplaced", "stiffening"]
    counts = written["kinds"]["stiffening"]
    assert sum(counts[key] for key in ("answered", "doubted", "refused", "dropped")) == 3
    assert (result.exit_code == 0) is written["holds"]
    assert "SYNTHETIC plants" in result.stdout
    assert {p.name for p in tmp_path.glob("calibration_*.png")} == {"calibration_coverage.png", "calibration_ranks.png"}


@pytest.mark.parametrize("kinds", ["stiff", ","])
def test_plants_that_are_none_are_refused(toy, tmp_path, kinds):
    trained = ("calibrate", toy, "--trained", tmp_path / "no.npz", "-o", tmp_path / "c.json")
    said = refused(*trained, "--kinds", kinds)
    assert "--kinds" in said
    assert "twin, misplaced, sliding, stiffening" in said


def test_a_calibration_is_of_a_posterior_or_of_a_search(toy, tmp_path):
    plain, trained = ("calibrate", toy, "-o", tmp_path / "c.json"), ("--trained", tmp_path / "no.npz")
    assert "neither --trained nor --method" in refused(*plain)
    assert "both --trained and --method" in refused(*plain, *trained, "--method", "least_squares")
    assert "--trained: --free, --use together with this file" in refused(
        *plain, *trained, "--free", "K1", "--use", "all"
    )
    assert "calibrated fits are JSON" in refused(*plain, "--method", "gradient", "--widen", tmp_path / "w.npz")
    assert "method: 'best'" in refused(*plain, "--method", "best")
    few = refused(*plain, "--method", "gradient", "--widen", tmp_path / "w.json", "--plants", 18)
    assert "--widen: 18 plants; expected: at least 19 of each kind" in few
    assert not list(tmp_path.iterdir())
