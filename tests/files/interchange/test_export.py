"""What is exported, read back by others: OpenSim's own package, glTF readers, and parsers written for these tests."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from knee_models import model
from opensim_process import TABLE, ask
from opensim_process import poses as opensim_poses
from other_readers import Glb, read_table
from scipy.spatial.transform import Rotation
from small_scene import small_result
from typer.testing import CliRunner

from pftwin.base.errors import InputError, OutputError, PftwinWarning
from pftwin.cli import app
from pftwin.dynamics.status import Status
from pftwin.files.interchange import export
from pftwin.files.result_files import load_dataset

LABELS = [
    "time",
    *(f"knee_{k}_r" for k in ("flex", "add", "rot", "tx", "ty", "tz")),
    *(f"pf_{k}_r" for k in ("flex", "rot", "tilt", "tx", "ty", "tz")),
]
OSIM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x anterior, y proximal, z lateral


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def file(result, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("result") / "knee.nc"
    result.save(path)
    return path


@pytest.fixture(scope="module")
def mot(file) -> Path:
    export(file, file.with_suffix(".mot"))
    return file.with_suffix(".mot")


def poses_in(result, body: str, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Turn and place in OpenSim's axes."""
    position, quaternion = (result.position, result.quaternion) if body == "patella" else result.tibia
    turn = Rotation.from_quat(quaternion[k], scalar_first=True).as_matrix()
    return OSIM @ turn @ OSIM.T, OSIM @ position[k]


def about(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[a, a], out[b, b], out[a, b], out[b, a] = c, c, -s, s
    return out


def test_mot_says_what_it_holds(result, mot):
    header, labels, rows = read_table(mot)
    assert header == {"version": "1", "nRows": str(result.times.size), "nColumns": "13", "inDegrees": "yes"}
    assert mot.read_text().startswith("Coordinates\n")
    assert labels == LABELS
    assert rows.shape == (result.times.size, 13)
    np.testing.assert_allclose(rows[:, 0], result.times, atol=1e-12)


def test_mot_gives_the_poses_back(result, mot):
    """By three turns about z, x and y of OpenSim's axes, flexion backwards, and places along the femur's."""
    _, labels, rows = read_table(mot)
    for body, joint, second, third in (("tibia", "knee", "add", "rot"), ("patella", "pf", "rot", "tilt")):
        columns = [rows[:, labels.index(f"{joint}_{k}_r")] for k in ("flex", second, third, "tx", "ty", "tz")]
        for k in (0, 7, -1):
            flex, b, c = (np.radians(v[k]) for v in columns[:3])
            turn, place = poses_in(result, body, k)
            np.testing.assert_allclose(about(2, -flex) @ about(0, b) @ about(1, c), turn, atol=1e-10)
            np.testing.assert_allclose([v[k] for v in columns[3:]], place, atol=1e-12)


def test_mot_angles_are_the_results_own(result, mot):
    _, labels, rows = read_table(mot)
    flexion = rows[:, labels.index("knee_flex_r")]
    np.testing.assert_allclose(flexion, np.degrees(result.knee.flexion), atol=0.5)  # other sequence, same knee
    assert flexion.max() > 1


def test_opensim_reads_mot_and_sto(result, mot, file):
    table = ask(TABLE, mot)
    assert table["degrees"]
    assert table["rows"] == result.times.size
    assert ["time", *table["columns"]] == LABELS
    export(file, file.with_suffix(".sto"))
    everything = ask(TABLE, file.with_suffix(".sto"))
    assert everything["rows"] == result.times.size
    np.testing.assert_allclose(everything["columns"]["knee_flexion"], np.degrees(result.knee.flexion), atol=1e-9)


def test_opensims_bodies_move_as_the_results_do(result, mot, tmp_path):
    """A model with the joints of OpenSim JAM, posed by the file."""
    (tmp_path / "knee.osim").write_text(model(forces="", meshes=False))
    _, labels, rows = read_table(mot)
    chosen = (0, 11, result.times.size - 1)
    values = [
        {n: float(v if n[:-3].endswith("_t") else np.radians(v)) for n, v in zip(labels[1:], rows[k, 1:], strict=True)}
        for k in chosen
    ]
    found = opensim_poses(tmp_path / "knee.osim", values, ("femur_r", "tibia_r", "patella_r"))
    for k, at in zip(chosen, found, strict=True):
        femur, place = (np.array(v) for v in at["femur_r"])
        for body in ("tibia", "patella"):
            turn, origin = (np.array(v) for v in at[f"{body}_r"])
            expected = poses_in(result, body, k)
            np.testing.assert_allclose(femur.T @ turn, expected[0], atol=1e-9)
            np.testing.assert_allclose(femur.T @ (origin - place), expected[1], atol=1e-9)


def test_frames_that_are_not_finite_are_left_out(result, tmp_path):
    position = result.position.copy()
    position[-3:] = np.nan
    broken = dataclasses.replace(result, position=position)
    with pytest.warns(PftwinWarning, match="3 of .* frames are not finite"):
        export(broken, tmp_path / "a.mot")
    assert len(read_table(tmp_path / "a.mot")[2]) == result.times.size - 3
    export(broken, tmp_path / "a.glb")
    assert len(Glb(tmp_path / "a.glb").tracks("patella")["times"]) == result.times.size - 3
    with pytest.raises(InputError, match="no frame with a finite pose"):
        export(dataclasses.replace(result, position=result.position * np.nan), tmp_path / "b.mot")


def test_the_command(file, tmp_path):
    outputs = [tmp_path / f"knee.{kind}" for kind in ("mot", "sto", "glb", "csv")]
    options = [part for path in outputs for part in ("-o", str(path))]
    done = CliRunner().invoke(app, ["export", str(file), *options, "--json", "-"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["files"] == {str(p): p.stat().st_size for p in outputs}
    assert len(load_dataset(file)["time"]) == len(read_table(outputs[1])[2])


def test_the_command_refuses(file, tmp_path):
    for arguments, words in (
        ([str(file), "-o", str(tmp_path / "a.fbx")], "unknown format '.fbx'; expected: .mot, .sto, .glb, .csv"),
        ([str(tmp_path / "none.nc"), "-o", str(tmp_path / "a.mot")], "no such file"),
        ([str(file), "-o", str(tmp_path / "missing" / "a.mot")], "there is no folder"),
    ):
        done = CliRunner().invoke(app, ["export", *arguments])
        assert done.exit_code == 2, done.output
        assert words in done.stderr
    assert not list(tmp_path.iterdir())
    with pytest.raises(OutputError):
        export(file, tmp_path / "a.txt")


def test_an_invalid_motion_is_exported_and_flagged(result, tmp_path):
    lost = dataclasses.replace(result, flags=np.full_like(result.flags, int(Status.NO_CONTACT)))
    lost.save(tmp_path / "lost.nc")
    names = [tmp_path / f"lost{ending}" for ending in (".mot", ".sto", ".csv")]
    done = CliRunner().invoke(app, ["export", str(tmp_path / "lost.nc"), *(a for n in names for a in ("-o", str(n)))])
    assert done.exit_code == 3
    assert "INVALID: the button touches nothing" in done.output
    assert all(name.is_file() for name in names)
    for name in names[:2]:
        head = name.read_text().partition("endheader")[0]
        assert "Verdict: INVALID: the button touches nothing" in head
    assert CliRunner().invoke(app, ["export", str(tmp_path / "sound.nc"), "-o", str(names[0])]).exit_code == 2
