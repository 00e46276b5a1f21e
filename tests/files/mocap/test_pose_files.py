"""Poses from files: tables of quaternions, and matrices as OpenSim JAM writes them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pose_matrices import FRAMES, matrices, written
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.files.mocap import read_poses

HEADER = "time_s,angle_deg,femur_px_m,femur_py_m,femur_pz_m,femur_qw,femur_qx,femur_qy,femur_qz\n"


def table(tmp_path, text):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    return path


def test_poses_from_a_table(tmp_path):
    path = table(tmp_path, HEADER.replace("_m,", "_mm,") + "0,5,1,2,3,1,0,0,0\n0.01,6,1,2,4,0,1,0,0\n")
    poses = read_poses(path)
    assert list(poses) == ["femur"]
    np.testing.assert_allclose(poses["femur"].positions[1], [0.001, 0.002, 0.004])
    with pytest.raises(InputError, match=r"no body called 'femurr'.*did you mean 'femur'"):
        read_poses(path, ["femurr"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + "0,5,1,2,3,1,0,0,0\n0.01,6,1,2,4,1,1,0,0\n", r"body 'femur': row 2: a quaternion of length 1\.41"),
        (HEADER.replace("px_m", "px") + "0,5,1,2,3,1,0,0,0\n", "'femur_px' has no unit of length"),
        (HEADER.replace("femur_pz_m", "femur_pw_m") + "0,5,1,2,3,1,0,0,0\n", "no column 'femur_pz'"),
        (HEADER + "0,5,1,,3,1,0,0,0\n", "row 1 of the positions is missing"),
        ("time_s,F_N\n0,1\n", "no poses"),
    ],
)
def test_bad_tables(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_poses(table(tmp_path, text))


def test_recorded_poses_of_the_implant(dm_knee):
    poses = read_poses(dm_knee / "passive_flexion_poses.csv", ["femur", "tibia"])
    assert list(poses) == ["femur", "tibia"]
    assert poses["femur"].rate == pytest.approx(100)
    relative = Rotation.from_matrix(poses["tibia"].relative_to(poses["femur"]).matrices())
    turned = np.rad2deg((relative[50].inv() * relative[-1]).magnitude())
    assert 70 < turned < 100


def test_matrices_are_read_with_axes_in_columns(tmp_path):
    femur, patella = matrices(1), matrices(2)
    poses = read_poses(written(tmp_path / "a.sto", {"femur_r": femur, "patella_r": patella}))
    assert list(poses) == ["femur_r", "patella_r"]
    for body, expected in (("femur_r", femur), ("patella_r", patella)):
        np.testing.assert_allclose(poses[body].matrices(), expected[:, :3, :3], atol=1e-12)
        np.testing.assert_allclose(poses[body].positions, expected[:, :3, 3])
        np.testing.assert_allclose(poses[body].times, 0.02 * np.arange(FRAMES))
    relative = poses["patella_r"].relative_to(poses["femur_r"])
    np.testing.assert_allclose(relative.positions, (np.linalg.inv(femur) @ patella)[:, :3, 3], atol=1e-12)
    assert list(read_poses(tmp_path / "a.sto", ["patella_r"])) == ["patella_r"]
    with pytest.raises(InputError, match=r"no body called 'patela_r'.*did you mean 'patella_r'"):
        read_poses(tmp_path / "a.sto", ["patela_r"])


def test_the_header_is_not_trusted_and_frames_numbers_need_a_rate(tmp_path):
    """Times at 30 Hz from frames 1 to 7: the seventh is 7/30 s."""
    path = written(tmp_path / "a.sto", {"femur": matrices(1)}, 1.0 + np.arange(FRAMES), nRows=17, nColumns=FRAMES)
    with (
        pytest.warns(PftwinWarning, match="nrows=17, the file has 7"),
        pytest.warns(PftwinWarning, match="ncolumns=7, the file has 17"),
    ):
        poses = read_poses(path, rate=30)
    np.testing.assert_allclose(poses["femur"].times, (1 + np.arange(FRAMES)) / 30)
    with (
        warnings.catch_warnings(action="ignore"),
        pytest.raises(InputError, match="time counts frames, 1 to 7") as error,
    ):
        read_poses(path)
    assert "rate_Hz in [motion], --rate" in str(error.value)


@pytest.mark.parametrize("numbers", [[1, 3, 5, 7, 9, 11, 13], [1, 2, 4, 5, 6, 8, 9]])
def test_frames_may_be_missing(tmp_path, numbers):
    """Every second one, or some that were left out: they are numbers all the same."""
    path = written(tmp_path / "a.sto", {"femur": matrices(1)}, np.array(numbers, float))
    np.testing.assert_allclose(read_poses(path, rate=30)["femur"].times, np.array(numbers) / 30)
    with pytest.raises(InputError, match="time counts frames, 1 to"):
        read_poses(path)


@pytest.mark.parametrize(
    ("numbers", "found"),
    [
        ((11, 12, 12), "row 3 repeats the time 12 (frame number or seconds)"),
        ((11, 13, 12), "row 3 goes back in time: 12 after 13 (frame numbers or seconds)"),
        ((1.5, 2.5, 2.5), "row 3 repeats the time 2.5 s"),
    ],
)
def test_frame_numbers_are_not_called_seconds(tmp_path, numbers, found):
    path = written(tmp_path / "a.sto", {"femur": matrices(1)}, np.array([*numbers, 14, 15, 16, 17], float))
    for rate in (None, 30):
        with pytest.raises(InputError) as said:
            read_poses(path, rate=rate)
        assert found in str(said.value)


def test_no_bodies_are_none_and_a_held_frame_is_one_of_all_bodies(tmp_path):
    paused = matrices(1)[[0, 1, 2, 2, 4, 5, 6]]
    path = written(tmp_path / "a.sto", {"femur": paused, "tibia": matrices(2)})
    assert read_poses(path, []) == {}
    assert list(read_poses(path, ["femur"])) == ["femur"]
    both = written(tmp_path / "b.sto", {"femur": paused, "tibia": matrices(2)[[0, 1, 2, 2, 4, 5, 6]]})
    with pytest.raises(InputError, match="row 4 repeats row 3"):
        read_poses(both, ["femur"])


def test_a_rate_beside_times_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"a rate of 30 Hz, and times from 0 to 0\.12"):
        read_poses(written(tmp_path / "a.sto", {"femur": matrices(1)}), rate=30)
    with pytest.raises(InputError, match="a rate beside times in seconds"):
        read_poses(table(tmp_path, HEADER + "0,5,1,2,3,1,0,0,0\n"), rate=30)
    for rate in (0.0, np.nan, -30.0):
        with pytest.raises(InputError, match="rate: found"):
            read_poses(tmp_path / "a.sto", rate=rate)


def _with(row: int, change) -> np.ndarray:
    """Of which one row (from 1) is changed."""
    found = matrices(1)
    found[row - 1] = change(found[row - 1])
    return found


def _set(m: np.ndarray, i: int, j: int, value: float) -> np.ndarray:
    return np.where((np.arange(16) == 4 * i + j).reshape(4, 4), value, m)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (np.swapaxes(matrices(1), 1, 2), "row 1: a transposed matrix, with the position in the last row"),
        (_with(3, lambda m: _set(m, 3, 2, 0.5)), "row 3: a matrix whose last row is not 0 0 0 1"),
        (_with(2, lambda m: np.diag([1.0, 1.0, 0.0, 1.0])), "row 2: a singular matrix"),
        (_with(4, lambda m: m @ np.diag([1.0, 1.0, -1.0, 1.0])), "row 4: a mirrored matrix"),
        (_with(5, lambda m: m @ np.diag([1.0, 1.1, 1.0, 1.0])), "row 5: a matrix whose axes are not of length one"),
        (_with(6, lambda m: _set(m, 1, 3, 120.0)), "row 6: more than 10 m from the origin: in millimetres"),
        (_with(7, lambda m: _set(m, 0, 0, np.nan)), "row 7: a matrix with missing numbers"),
        (matrices(1)[[0, 1, 2, 2, 4, 5, 6]], "row 4 repeats row 3 to the last digit"),
    ],
)
def test_what_is_no_pose_is_named_with_its_row(tmp_path, wrong, said):
    with pytest.raises(InputError, match=said):
        read_poses(written(tmp_path / "a.sto", {"femur": wrong}))


def test_a_body_may_stand_still_while_another_moves(tmp_path):
    still = np.tile(matrices(1)[:1], (FRAMES, 1, 1))
    poses = read_poses(written(tmp_path / "a.sto", {"femur": still, "tibia": matrices(2)}))
    assert np.ptp(poses["femur"].positions) == pytest.approx(np.ptp(still[0, :3, 3]))
    assert len(read_poses(written(tmp_path / "b.sto", {"femur": still}))["femur"].times) == FRAMES


def test_incomplete_matrices_are_refused(tmp_path):
    path = written(tmp_path / "a.sto", {"femur": matrices(1)})
    path.write_text(path.read_text().replace("femur_T23", "femur_x23"))
    with pytest.raises(InputError, match="body 'femur' has no column 'femur_T23'"):
        read_poses(path)
    path.write_text(path.read_text().replace("femur_T11", "femur_x11"))
    with pytest.raises(InputError, match=r"no poses; expected: columns BODY_T11 \.\.\. BODY_T44"):
        read_poses(path)


def test_measured_poses_of_a_living_knee(healthy_knee):
    """60 frames at 30 Hz: the knee bends by about 35 deg in one cycle of 2 s, and the tibia stays at the femur."""
    with pytest.warns(PftwinWarning, match="nrows=48, the file has 60"):
        poses = read_poses(healthy_knee / "passive_body_transformations.sto", rate=30)
    assert list(poses) == ["femur_distal_r", "tibia_proximal_r", "patella_r"]
    assert poses["patella_r"].rate == pytest.approx(30)
    tibia = poses["tibia_proximal_r"].relative_to(poses["femur_distal_r"])
    flexion = -np.degrees(Rotation.from_matrix(tibia.matrices()).as_euler("zxy")[:, 0])
    assert np.ptp(flexion) == pytest.approx(35, abs=3)
    assert 5 < flexion.min() < 15
    assert abs(flexion[0] - flexion[-1]) < 5
    assert np.linalg.norm(tibia.positions, axis=1).max() < 6e-3
