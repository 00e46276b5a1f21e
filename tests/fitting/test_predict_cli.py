"""`pftwin predict`: a fitted knee in its own recording and in another."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from made_estimates import made_estimate
from toy_scene_files import LIGHT, START, fixed_poses, tibia_poses, write_poses, write_toy
from typer.testing import CliRunner, Result

from fitting.prediction.predicted_motion import PredictedMotion
from pftwin import load_scene
from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.scene_file import load_scene_file

LEFT = {"X": 0.4e-3, "Y": 0.9e-3, "Z": 1.7e-3, "tilt": 0.02, "flexion": 0.03, "rotation": 0.05}
MEASURED = '\n[measured]\npatella = { body = "patella" }\n'


def pftwin(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of 30 frames, and another, shorter and slower recording in another folder."""
    scene = write_toy(tmp_path_factory.mktemp("toy"), LIGHT + MEASURED)
    for path, rate, count in ((scene.with_name("poses.csv"), 120, 31), (scene.parent.parent / "other.csv", 60, 21)):
        tibia = tibia_poses(count, rate=rate)
        write_poses(path, {"tibia": tibia, "patella": fixed_poses(tibia, *START)})
    scene.with_name("fit.json").write_text(
        json.dumps(made_estimate({"K1": (158.0, 3.0), "L2": (0.0715, 2e-4)}, rmse=LEFT).to_dict())
    )
    return scene.parent


def test_another_recording_takes_the_place_of_the_scenes(folder):
    own, other = (
        load_scene(folder / "scene.toml"),
        load_scene(folder / "scene.toml", motion=folder.parent / "other.csv"),
    )
    assert (own.motion.times.size, other.motion.times.size) == (31, 21)
    assert float(other.motion.frame_interval) == pytest.approx(1 / 60)
    assert other.measured.times.size == 21
    assert other.get("K1") == own.get("K1")
    with pytest.raises(InputError, match="no such file"):
        load_scene(folder / "scene.toml", motion=folder.parent / "none.csv")
    with pytest.raises(InputError, match="rate"):
        load_scene_file(folder / "scene.toml", motion=folder.parent / "other.csv", rate=30.0)


def test_spans_of_time_belong_to_the_scenes_own_recording(folder):
    text = (folder / "scene.toml").read_text().replace("[motion]", "[motion]\nend_time_s = 0.2")
    (folder / "short.toml").write_text(text)
    assert load_scene(folder / "short.toml").motion.end_time == pytest.approx(0.2)
    assert load_scene(folder / "short.toml", motion=folder.parent / "other.csv").motion.times.size == 21


@pytest.mark.slow
def test_bands_are_written_and_reported(folder, tmp_path):
    from xarray import open_dataset

    out = tmp_path / "other.nc"
    options = ("--motion", folder.parent / "other.csv", "--samples", 6, "--set", "K1=150:170", "--during", "0:0.2")
    command = ("predict", folder / "scene.toml", "--estimate", folder / "fit.json", "-o", out, *options, "--json", "-")
    result = pftwin(*command)
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    assert [Path(f).name for f in facts["files"]] == ["other.nc", "other.png", "other.svg"]
    with open_dataset(out) as data:
        assert data.sizes == {"time": 21, "coordinate": 6}
        assert (data["high"] > data["low"]).all()
        kept = data["compared"].values.astype(bool)
        off = (data["value"] - data["measured"]).sel(coordinate="y").values[kept]
    assert kept.sum() == 13
    assert facts["errors"]["y"] == pytest.approx(float(np.sqrt(np.mean(off**2))))


@pytest.mark.parametrize("doubted", ["motion", "estimate"])
def test_an_invalid_prediction_says_so_once_and_before_its_table(folder, tmp_path, monkeypatch, doubted):
    from xarray import open_dataset

    far = "INVALID: the equilibrium is 28.7 mm from the recorded start"
    path = np.tile(np.arange(31.0)[:, None], (1, 6))
    verdict = far if doubted == "motion" else "valid"
    every = np.ones(31, dtype=bool)
    doubts = [] if doubted == "motion" else ["measured quadriceps is late"]
    estimate = dataclasses.replace(made_estimate({"K1": (158.0, 3.0)}, rmse=LEFT), doubts=doubts)
    estimate.save(tmp_path / "fit.json")
    ends = path - 1, path + 1, path + 0.5, every
    motion = PredictedMotion("toy", np.arange(31.0), path, *ends, verdict, ("bands",), estimate.objection)
    monkeypatch.setattr("fitting.prediction.motion.predict_motion", lambda *_, **__: motion)
    options = ("--estimate", tmp_path / "fit.json", "-o", tmp_path / "a.nc", "--no-figure")
    result = pftwin("predict", folder / "scene.toml", *options)
    assert result.exit_code == 3, result.output
    lines = result.stdout.splitlines()
    assert lines[0].startswith(far if doubted == "motion" else "INVALID: measured quadriceps is late")
    assert result.stdout.count("INVALID") == 1
    assert any("centre, lateral" in line for line in lines[1:])
    assert "bands" in lines
    with open_dataset(tmp_path / "a.nc") as data:
        assert ("INVALID: measured quadriceps is late" in data.attrs["note"]) is (doubted == "estimate")


def test_what_is_no_table_is_refused_as_ever(folder):
    for table, text in (("[motion]", 'motion = "poses.csv"'), ("[measured]", 'measured = "poses.csv"')):
        whole = (folder / "scene.toml").read_text()
        start = whole.index(table)
        end = whole.index("[", start + 1) if table == "[motion]" else len(whole)
        (folder / "bad.toml").write_text(text + "\n" + whole[:start] + whole[end:])
        with pytest.raises(InputError, match=text.split()[0]):
            load_scene(folder / "bad.toml", motion=folder.parent / "other.csv")


def test_tensions_over_time_belong_to_the_scenes_own_recording(folder):
    pulls = '\n[[prescribed_tension]]\nbody = "femur"\nfile = "pulls.csv"\n'
    (folder / "pulled.toml").write_text((folder / "scene.toml").read_text() + pulls)
    with pytest.raises(
        InputError, match="tension_N, with at_flexion_deg for one that changes, or a scene file of that recording"
    ):
        load_scene(folder / "pulled.toml", motion=folder.parent / "other.csv")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--rate", 30), "a rate without --motion"),
        (("--set", "K1"), "each once"),
        (("--set", "K1=1:2:3"), "each once"),
        (("--set", "K1=1", "--set", "K1=2"), "given twice"),
        (("--during", "0.1"), "such as"),
    ],
)
def test_what_is_no_command_is_refused(folder, tmp_path, options, words):
    given = ("predict", folder / "scene.toml", "--estimate", folder / "fit.json", "-o", tmp_path / "a.nc", *options)
    result = pftwin(*given)
    assert result.exit_code == 2, result.output
    assert words in result.stderr
    assert not list(tmp_path.iterdir())
