"""Markers and bones that jump, in a scene's recording: mended where that can be, and named; else refused by frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from seen_clusters import clusters, seen, tibia_seen
from toy_scene_files import LIGHT, START, changed, fixed_poses, refused, tibia_poses, write_poses

from pftwin.files.mocap import PoseSeries
from pftwin.files.scene_file import load_scene_file


def origins(folder: Path, text: str, name: str = "odd.toml") -> tuple[np.ndarray, tuple[str, ...]]:
    """The tibia's path (n, 3) [m], and the notes."""
    (folder / name).write_text(text)
    loaded = load_scene_file(folder / name)
    frames = loaded.scene.motion.tibia.frames(np.arange(41) / 100)
    ends = np.asarray(frames.origin.array()) + np.asarray(frames.rotation.ex.array())  # 1 m along the shank
    return ends, loaded.notes


def test_a_marker_that_jumps_is_left_out_and_named_and_exchanged_ones_are_put_back(toy: Path) -> None:
    good = seen(3e-4)
    filtered = changed("[motion]\n", "[motion]\ncutoff_Hz = 20\n", tibia_seen(good, toy, clusters()))
    true, _ = origins(toy, filtered)
    t4, swapped = good.names.index("T4"), [good.names.index(n) for n in ("T1", "T2")]
    points = good.positions.copy()
    points[12:27, t4] += [0.03, -0.05, 0.02]  # longer than a gap that is filled
    points[np.ix_(range(33, 36), swapped)] = points[np.ix_(range(33, 36), swapped[::-1])]
    tibia_seen(good.with_positions(points), toy, clusters())
    got, notes = origins(toy, filtered)
    assert np.linalg.norm(got - true, axis=1).max() < 1e-2  # the others' noise, over 1 m
    assert "T4 left out in frames 13 to 27 of 41 (counted from 1): astray from the markers beside" in notes
    assert "T1, T2 exchanged in frames 34 to 36 of 41 (counted from 1): put back" in notes
    tibia_seen(good, toy, clusters())
    assert not [n for n in origins(toy, filtered, "good.toml")[1] if "left out" in n or "jump" in n]


def test_of_three_markers_the_frame_is_refused_or_named(toy: Path) -> None:
    good = seen(1e-4)
    p1 = good.names.index("P1")
    points = good.positions.copy()
    points[20, p1] += [0.04, 0.0, 0.0]
    text = tibia_seen(good.with_positions(points), toy, clusters())
    assert "rms in frame 21 (from 1): names swapped?" in refused(toy, text)
    text = changed("limits = {", "limits = { most_marker_residual_mm = 50, most_marker_residual_ratio = 1e9,", text)
    notes = origins(toy, text)[1]
    note = "P1, P2, P3 jump against each other in frame 21 of 41 (counted from 1), and are left as they are"
    assert any(n.startswith(note) for n in notes)


def jumping(folder: Path, frames: list[int]) -> str:
    tibia = tibia_poses()
    turn = np.zeros((41, 3))
    turn[frames] = [2.0, 1.0, 0.0]
    turns = Rotation.from_quat(tibia.quaternions, scalar_first=True) * Rotation.from_rotvec(turn)
    odd = PoseSeries(tibia.times, tibia.positions, turns.as_quat(scalar_first=True))
    write_poses(folder / "odd.csv", {"tibia": odd, "patella": fixed_poses(tibia, *START)})
    return changed('"poses.csv"', '"odd.csv"', LIGHT)


def test_a_tibia_that_jumps_out_and_back_is_filled_and_named(toy: Path) -> None:
    true, notes = origins(toy, LIGHT)
    assert not [n for n in notes if "spline" in n]
    got, notes = origins(toy, jumping(toy, [10, 11, 12, 30]))
    assert np.linalg.norm(got - true, axis=1).max() < 1e-4
    (note,) = (n for n in notes if "spline" in n)
    assert "odd.csv, body 'tibia': frames 11 to 13, 31 of 41 (counted from 1) filled by a spline" in note
    said = refused(toy, jumping(toy, list(range(10, 21))))
    assert "[motion]: odd.csv, body 'tibia': femur and tibia jump against each other in frames 11 to 21 of 41" in said
    assert "at most 0.1 s (max_gap_s)" in said
    wide = changed("[motion]\n", "[motion]\nmax_gap_s = 0.2\n", jumping(toy, list(range(10, 21))))
    assert np.linalg.norm(origins(toy, wide)[0] - true, axis=1).max() < 5e-3
    assert "frames 40 to 41 of 41" in refused(toy, jumping(toy, [39, 40]))
    (toy / "start.toml").write_text(jumping(toy, [0, 1, 30]))
    loaded = load_scene_file(toy / "start.toml")
    assert loaded.scene.motion.n_frames == 39
    assert (
        "the scene starts at 0.02 s: femur and tibia jump against each other in frames 1 to 2 of 41" in loaded.notes[0]
    )
    assert "frame 29 of 39 (counted from 1) filled by a spline" in loaded.notes[1]
    later = changed("[motion]\n", "[motion]\nstart_time_s = 0.02\n", jumping(toy, [0, 1]))
    (toy / "later.toml").write_text(later)
    assert load_scene_file(toy / "later.toml").scene.motion.n_frames == 39


def test_a_motion_that_is_meant_is_let_through_by_name(toy: Path) -> None:
    tibia = tibia_poses()
    places = np.where((np.arange(41) // 12 == 1)[:, None], [0.03, 0.0, 0.0], tibia.positions)
    shifted = PoseSeries(tibia.times, places, tibia.quaternions)
    write_poses(toy / "odd.csv", {"tibia": shifted, "patella": fixed_poses(tibia, *START)})
    text = changed('"poses.csv"', '"odd.csv"', LIGHT)
    assert "frames 13 to 24 of 41" in refused(toy, text)
    (toy / "meant.toml").write_text(changed("limits = {", "limits = { most_knee_speed_m_per_s = 5,", text))
    motion = load_scene_file(toy / "meant.toml").scene.motion
    np.testing.assert_allclose(motion.tibia.frames(0.18).origin.array(), [0.03, 0, 0], atol=1e-9)
