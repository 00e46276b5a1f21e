"""Segments that are seen through two markers and a joint's centre, lent by the neighbour or found from the motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_scene_files import CLUSTERS, changed, markers_of, refused, same

from pftwin.files.mocap import MarkerTrajectories, PoseSeries, read_markers, write_trc
from pftwin.files.scene_file import load_scene_file
from pftwin.files.scene_file.loading import LoadedScene
from pftwin.model.motion import SegmentMotion

KNEE = np.array([0.004, -0.003, 0.006])  # the joint's centre in the femur, and, where both are straight, in the tibia
TIBIA = [0.002, 0.001, -0.004]  # the same point in the tibia's frame
FRAMES = 81
T = np.arange(FRAMES) / 100


def femur() -> PoseSeries:
    turns = Rotation.from_rotvec(np.outer(np.sin(4 * T), [0.1, 0.2, 0.05]))
    return PoseSeries(T, np.outer(np.sin(3 * T), [0.05, 0.02, 0.04]), turns.as_quat(scalar_first=True))


def tibia(turn: float = 1.0) -> PoseSeries:
    """Turns about the knee's centre in three directions."""
    waves = np.stack([0.2 * np.sin(9 * T), -0.6 - 0.4 * np.sin(7 * T), 0.2 * np.sin(11 * T + 1)], axis=1)
    thigh = femur()
    turns = Rotation.from_quat(thigh.quaternions, scalar_first=True) * Rotation.from_rotvec(turn * waves)
    center = thigh.positions + thigh.matrices() @ KNEE
    return PoseSeries(T, center - turns.as_matrix() @ TIBIA, turns.as_quat(scalar_first=True))


def scene(folder: Path, center: str, *, noise: float = 0.0, turn: float = 1.0, more: str = "") -> str:
    """A scene whose tibia is seen through T1, T2 and the point `knee`."""
    markers = markers_of({"femur": femur(), "tibia": tibia(turn)})
    moved = markers.positions + noise * np.random.default_rng(1).normal(size=markers.positions.shape)
    write_trc(folder / "knee.trc", MarkerTrajectories(markers.times, markers.names, moved))

    def table(places) -> str:
        return "{ " + ", ".join(f"{name} = {list(place)}" for name, place in places.items()) + " }"

    two = table({"T1": CLUSTERS["tibia"]["T1"], "T2": CLUSTERS["tibia"]["T2"], "knee": TIBIA})
    text = changed('poses = "poses.csv"', f'markers = "knee.trc"\njoint_centers.knee = {center}{more}')
    text = changed('[tibia]\nbody = "tibia"', f"[tibia]\ncluster_m = {two}", text)
    start = "fixed = { position_m = [-0.005, 0.001, 0.05] }"
    text = changed(start, f'relative_to = "femur", {start}', text)
    return text + f"\n[femur]\ncluster_m = {table(CLUSTERS['femur'])}\n"


def loaded(folder: Path, text: str) -> LoadedScene:
    (folder / "two.toml").write_text(text)
    return load_scene_file(folder / "two.toml")


def path(motion: SegmentMotion) -> tuple[np.ndarray, np.ndarray]:
    frames = motion.frames(T)
    return np.asarray(frames.origin.array()), np.asarray(frames.rotation.array())


def check(motion: SegmentMotion, true: PoseSeries, atol: float) -> None:
    origin, rotation = path(motion)
    same(origin, true.positions, atol=atol)
    same(rotation, true.matrices(), atol=10 * atol)  # markers are some 0.1 m apart


def test_a_point_that_the_femur_lends_is_the_tibias_third_marker(toy: Path) -> None:
    got = loaded(toy, scene(toy, f'{{ about = "femur", point_mm = {(1e3 * KNEE).tolist()} }}'))
    check(got.scene.motion.tibia, tibia(), 1e-6)
    assert got.scene.motion.femur is not None
    check(got.scene.motion.femur, femur(), 1e-6)
    assert len([n for n in got.notes if n.startswith("femur: markers fit")]) == 1
    assert any(n.startswith("tibia: markers fit") and "over the motion T1 0.00, T2 0.00, knee 0.00 mm" in n
               for n in got.notes)  # fmt: skip


@pytest.mark.parametrize("about", ['about = "femur"', 'about_markers = ["F1", "F2", "F3"]'])
def test_a_centre_that_the_motion_tells_is_the_tibias_third_marker(toy: Path, about: str) -> None:
    got = loaded(toy, scene(toy, f'{{ {about}, of = ["T1", "T2"] }}'))
    check(got.scene.motion.tibia, tibia(), 1e-6)
    (note,) = (n for n in got.notes if n.startswith("knee: "))
    assert "T1, T2 turn about it by up to" in note
    assert "within 0.00 mm rms" in note


def test_noise_and_a_little_motion(toy: Path) -> None:
    center = '{ about = "femur", of = ["T1", "T2"] }'
    noisy = loaded(toy, scene(toy, center, noise=3e-4))
    origin, _ = path(noisy.scene.motion.tibia)
    assert np.sqrt(np.mean(np.sum((origin - tibia().positions) ** 2, axis=1))) < 2e-3
    said = refused(toy, scene(toy, center, noise=1e-3, turn=0.1))
    assert "[motion] joint_centers.knee: T1, T2 turn about it by up to" in said
    assert "(most_center_deviation_mm)" in said


def test_the_segment_in_which_a_centre_is_fixed_is_mended_too(toy: Path) -> None:
    """Two of four further markers on the thigh, exchanged in three frames, would turn it round there."""
    text = scene(toy, '{ about_markers = ["G1", "G2", "G3", "G4"], of = ["T1", "T2"] }')
    seen, thigh = read_markers(toy / "knee.trc"), femur()
    places = [(0.20, 0.05, 0.03), (0.25, -0.04, 0.05), (0.15, 0.01, 0.08), (0.22, 0.03, -0.04)]
    more = thigh.positions[:, None] + np.einsum("nij,mj->nmi", thigh.matrices(), places)
    more[40:43, [0, 1]] = more[40:43, [1, 0]]
    names, positions = (*seen.names, "G1", "G2", "G3", "G4"), np.concatenate([seen.positions, more], axis=1)
    write_trc(toy / "knee.trc", MarkerTrajectories(seen.times, names, positions))
    got = loaded(toy, text)
    assert any("G1, G2 exchanged in frames 41 to 43" in n for n in got.notes), got.notes
    check(got.scene.motion.tibia, tibia(), 1e-6)


def test_a_centre_in_the_world(toy: Path) -> None:
    """Of a femur whose hip stands still, as with a fixed point."""
    hip = np.array([0.4, 0.01, 0.02])
    turns = Rotation.from_rotvec(np.stack([0.4 * np.sin(5 * T), 0.5 * np.sin(3 * T), 0.3 * np.sin(8 * T)], axis=1))
    thigh = PoseSeries(T, hip - turns.as_matrix() @ hip, turns.as_quat(scalar_first=True))
    shin = PoseSeries(T, thigh.positions, (turns * Rotation.from_rotvec([0, -0.5, 0])).as_quat(scalar_first=True))
    write_trc(toy / "hip.trc", markers_of({"femur": thigh, "tibia": shin}))
    text = changed('poses = "poses.csv"', 'markers = "hip.trc"\njoint_centers.hip = { of = ["F1", "F2"] }')
    text = changed(
        'body = "tibia"',
        f"cluster_m = {{ {', '.join(f'{n} = {list(p)}' for n, p in CLUSTERS['tibia'].items())} }}",
        text,
    )
    start = "fixed = { position_m = [-0.005, 0.001, 0.05] }"
    text = changed(start, f'relative_to = "femur", {start}', text)
    places = {"F1": CLUSTERS["femur"]["F1"], "F2": CLUSTERS["femur"]["F2"], "hip": hip.tolist()}
    text += f"\n[femur]\ncluster_m = {{ {', '.join(f'{n} = {list(p)}' for n, p in places.items())} }}\n"
    motion = loaded(toy, text).scene.motion
    assert motion.femur is not None
    check(motion.femur, thigh, 1e-6)


def test_tables_that_say_too_little_or_too_much(toy: Path) -> None:
    def said(center: str, **more) -> str:
        return refused(toy, scene(toy, center, **more))

    assert "neither point_m nor of; expected: its place" in said('{ about = "femur" }')
    assert "both point_m and of" in said('{ of = ["T1"], point_m = [0, 0, 0] }')
    assert "about_markers beside point_m" in said('{ about_markers = ["F1", "F2", "F3"], point_m = [0, 0, 0] }')
    assert "about_markers beside about" in said('{ about = "tibia", about_markers = ["F1", "F2", "F3"], of = ["T1"] }')
    assert "no marker called 'T9'" in said('{ of = ["T9"] }')
    assert "knee is found by means of itself" in said('{ about = "tibia", of = ["F1", "F2"] }')
    twice = said('{ about = "femur", point_m = [0, 0, 0] }', more="\nfixed_points_m.knee = [0, 0, 0]")
    assert "knee is a fixed point and a joint centre" in twice
