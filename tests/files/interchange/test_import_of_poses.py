"""OpenSim models whose bones, and maybe the patella, move as they were measured."""

from __future__ import annotations

import json

import numpy as np
import pytest
from knee_models import ligaments, model
from pose_matrices import written
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.interchange import import_osim
from pftwin.files.mocap import read_poses
from pftwin.files.scene_file import load_scene_file

ANATOMICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # proximal, lateral, anterior of x, y, z
FRAMES = 31
START = (0.045, 0.002, 0.003)  # of the patella in the femur [m]


def pose(turns: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n, 4, 4) from rotation vectors and places (n, 3)."""
    found = np.tile(np.eye(4), (len(turns), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = Rotation.from_rotvec(turns).as_matrix(), places
    return found


def motion(*, patella: bool = True) -> dict[str, np.ndarray]:
    """In a scanner's frame, the femur moving a little; x anterior, y proximal, z to the right."""
    t = np.linspace(0, 1, FRAMES)[:, None]
    femur = pose(t * [0.02, -0.05, 0.3] + [0.3, 0.2, 0.1], [0.1, 0.2, 0.3] + t * [0.004, 0.001, 0.002])
    tibia = femur @ pose(t * [0.0, 0.02, -0.5] - [0, 0, 0.2], np.tile([0.001, -0.002, 0.0], (FRAMES, 1)))
    button = femur @ pose(t * [0.03, 0.0, -0.3], np.array(START) + t * [-0.004, -0.01, 0.001])
    bodies = {"femur_r": femur, "tibia_r": tibia, "patella_r": button}
    return bodies if patella else {name: bodies[name] for name in ("femur_r", "tibia_r")}


def imported(folder, bodies: dict[str, np.ndarray], **options):
    (folder / "bare.osim").write_text(model(forces=ligaments(), meshes=False))
    path = written(folder / "measured.sto", bodies, 1.0 + np.arange(FRAMES))
    return import_osim(folder / "bare.osim", folder / "out", motion=path, **{"rate": 30, **options})


def test_bones_move_as_measured_and_the_patella_is_what_is_compared(tmp_path):
    report = imported(tmp_path, motion())
    assert "motion: poses of femur_r, tibia_r, patella_r from" in report.notes[0]
    assert "the patella's are what was measured" in report.notes[0]
    assert "not used" not in report.notes[0]
    scene, bodies = load_scene_file(report.scene).scene, motion()
    np.testing.assert_allclose(scene.motion.times, (1 + np.arange(FRAMES)) / 30)
    seen = np.linalg.inv(bodies["femur_r"]) @ bodies["patella_r"]
    assert scene.measured is not None
    np.testing.assert_allclose(scene.measured.center, seen[:, :3, 3] @ ANATOMICAL.T, atol=1e-9)
    turns = Rotation.from_quat(scene.measured.quaternion, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turns, ANATOMICAL @ seen[:, :3, :3] @ ANATOMICAL.T, atol=1e-9)
    femur, tibia = (part.frames(scene.motion.times[-1]) for part in (scene.motion.femur, scene.motion.tibia))
    shin = np.asarray(femur.rotation.array()).T @ np.asarray(tibia.rotation.array())
    expected = (np.linalg.inv(bodies["femur_r"]) @ bodies["tibia_r"])[-1, :3, :3]
    np.testing.assert_allclose(shin, ANATOMICAL @ expected @ ANATOMICAL.T, atol=1e-9)


def test_the_command_names_frames_that_are_out_of_line(tmp_path):
    """As loading the scene does: a patella turned by 175 deg in the first frame and in two later ones."""
    bodies = motion()
    bodies["patella_r"][[0, 9, 10], :3, :3] = (
        bodies["patella_r"][[0, 9, 10], :3, :3] @ Rotation.from_rotvec([0, 3.05, 0]).as_matrix()
    )
    (tmp_path / "bare.osim").write_text(model(forces=ligaments(), meshes=False))
    written(tmp_path / "poses.sto", bodies, np.arange(FRAMES) / 30)
    command = ["import", str(tmp_path / "bare.osim"), "--motion", str(tmp_path / "poses.sto")]
    done = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "out"), "--json", str(tmp_path / "facts")])
    assert done.exit_code == 3, done.output  # without contact
    notes = json.loads((tmp_path / "facts").read_text())["notes"]
    for words in ("the patella jumps in frame 1 of 31", "the patella's frames 9 to 10 of 30"):
        assert any(words in note for note in notes)
        assert words in " ".join(done.stdout.split())


def test_bodies_of_the_file_that_are_not_used_are_named(tmp_path):
    bodies = motion()
    report = imported(tmp_path, bodies | {"talus_r": bodies["tibia_r"], "patela_r": bodies.pop("patella_r")})
    assert "starts where the model has it in femur_r; not used: talus_r, patela_r; " in report.notes[0]


def test_a_patella_that_was_not_measured_starts_where_the_model_has_it(tmp_path):
    """In the femur's frame: as where the knee is bent through its range."""
    report = imported(tmp_path, motion(patella=False))
    assert "patella_r starts where the model has it in femur_r" in report.notes[0]
    loaded = load_scene_file(report.scene)
    assert loaded.scene.measured is None
    by_model = import_osim(tmp_path / "bare.osim", tmp_path / "bent")
    other = load_scene_file(by_model.scene).scene

    def start(scene) -> np.ndarray:
        femur = scene.motion.femur.frames(scene.motion.start_time)
        turn = np.asarray(femur.rotation.array())
        return turn.T @ (np.asarray(scene.start.position.array()) - np.asarray(femur.origin.array()))

    np.testing.assert_allclose(start(loaded.scene), start(other), atol=1e-9)


def test_what_is_missing_is_named(tmp_path):
    bodies = motion()
    with pytest.raises(InputError, match="no body called 'tibia_r'"):
        imported(tmp_path, {name: bodies[name] for name in ("femur_r", "patella_r")})
    with pytest.raises(InputError, match="time counts frames, 1 to 31"):
        imported(tmp_path, bodies, rate=None)
    with pytest.raises(InputError, match="a rate without a file of poses"):
        import_osim(tmp_path / "bare.osim", tmp_path / "out", rate=30)
    assert not (tmp_path / "out").exists()


def test_a_scene_file_takes_such_poses_with_their_rate(tmp_path):
    report = imported(tmp_path, motion())
    text = report.scene.read_text()
    scene, path = report.scene.with_name("direct.toml"), report.scene.with_name("measured.sto")
    (tmp_path / "measured.sto").rename(path)
    scene.write_text(text.replace('poses = "poses.csv"', 'poses = "measured.sto"\nrate_Hz = 30'))
    direct, through = (load_scene_file(path).scene.measured for path in (scene, report.scene))
    assert direct is not None
    assert through is not None
    np.testing.assert_allclose(direct.center, through.center, atol=1e-11)
    np.testing.assert_allclose(direct.times, through.times)
    scene.write_text(text.replace('poses = "poses.csv"', 'poses = "measured.sto"'))
    with pytest.raises(InputError, match=r"rate_Hz in \[motion\]"):
        load_scene_file(scene)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*the header says nrows=48")
def test_a_living_knee_is_a_scene_with_its_measurements(healthy_knee, tmp_path):
    recording = healthy_knee / "passive_body_transformations.sto"
    options = ["--side", "right", "--motion", str(recording)]
    command = ["import", str(healthy_knee / "lenhart2015.osim"), *options, "--rate", "30", "-o", str(tmp_path / "knee")]
    done = CliRunner().invoke(app, [*command, "--quadriceps", "40"])
    assert done.exit_code == 0, done.output
    scene = load_scene_file(tmp_path / "knee" / "scene.toml").scene
    assert float(np.sum(scene.get("quadriceps.tension")[0])) == pytest.approx(40)
    measured = scene.measured
    poses = read_poses(recording, rate=30)
    seen = poses["patella_r"].relative_to(poses["femur_distal_r"])
    assert measured is not None
    assert len(measured.times) == 60
    np.testing.assert_allclose(measured.center, seen.positions @ ANATOMICAL.T, atol=1e-9)
