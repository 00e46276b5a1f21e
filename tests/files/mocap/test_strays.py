"""Markers that leave their cluster: found and put right, and healthy recordings kept as they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pftwin.files.mocap import MarkerTrajectories, mean_cluster, mended_cluster, read_trc
from pftwin.rig import geometry as rig
from pftwin.rig.recording import recording_files

PLACES = np.array([[0, 0, 0], [0.1, 0.01, 0], [0.02, 0.08, 0.01], [0.04, 0.05, -0.05], [0.12, 0.07, 0.03]])
N, NOISE = 150, 3e-4
NAMES: tuple[str, ...] = ("A", "B", "C", "D", "E")


def walking(markers: int, seed: int, skin: float = 6e-3) -> np.ndarray:
    """Markers (n, m, 3) of a shank in gait at 100 Hz, which slide on the skin, with the noise of cameras."""
    random, t = np.random.default_rng(seed), np.arange(N) / 100
    turns = Rotation.from_rotvec(np.stack([0.5 * np.sin(5 * t), 0.8 * np.sin(6 * t + 1), 0.3 * np.sin(7 * t)], axis=1))
    origin = np.stack([1.2 * t, 0.1 * np.sin(9 * t), 0.2 * np.cos(4 * t)], axis=1)
    phases = random.uniform(0, 2 * np.pi, size=(markers, 3))
    places = PLACES[:markers] + skin / 2 * np.sin(6 * t[:, None, None] + phases)
    points = np.einsum("nij,nmj->nmi", turns.as_matrix(), places) + origin[:, None]
    return points + NOISE * random.normal(size=points.shape)


def mended(points: np.ndarray):
    names = NAMES[: points.shape[1]]
    reference: dict[str, np.ndarray] = dict(zip(names, PLACES, strict=False))
    return mended_cluster(MarkerTrajectories(np.arange(len(points)) / 100, names, points), reference)


@settings(max_examples=25, deadline=None)
@given(markers=st.integers(3, 5), seed=st.integers(0, 2**31), skin=st.floats(0, 1e-2))
def test_a_good_cluster_is_not_changed(markers, seed, skin):
    points = walking(markers, seed, skin)
    points[np.random.default_rng(seed).random(points.shape[:2]) < 0.05] = np.nan
    got, strays = mended(points)
    assert strays == []
    np.testing.assert_array_equal(got.positions, points)


stretch = st.tuples(st.integers(5, N - 36), st.integers(1, 30)).map(lambda s: np.arange(s[0], s[0] + s[1]))


@settings(max_examples=40, deadline=None)
@given(
    markers=st.integers(4, 5),
    seed=st.integers(0, 2**31),
    which=st.integers(0, 3),
    frames=stretch,
    size=st.floats(0.05, 0.3),
    direction=st.integers(0, 2**31),
)
def test_a_marker_that_jumps_away_is_left_out_there(markers, seed, which, frames, size, direction):
    points = walking(markers, seed)
    ray = np.random.default_rng(direction).normal(size=3)
    spoiled = points.copy()
    spoiled[frames, which] += size * ray / np.linalg.norm(ray)
    got, strays = mended(spoiled)
    wrong = [s for s in strays if s.kind != "unexplained" and s.markers != (NAMES[which],)]
    assert wrong == []
    if markers == 5 or size > 0.1:  # of four, three others hardly tell a jump out of their plane that is not larger
        assert [(s.kind, s.markers) for s in strays] == [("left out", (NAMES[which],))]
        np.testing.assert_array_equal(np.flatnonzero(strays[0].frames), frames)
        np.testing.assert_array_equal(np.delete(got.positions, which, axis=1), np.delete(points, which, axis=1))
        assert np.abs(got.positions - points).max() < 0.012  # by the others, on their own skin


@settings(max_examples=40, deadline=None)
@given(
    markers=st.integers(4, 5), seed=st.integers(0, 2**31), pair=st.sampled_from([(0, 1), (0, 2), (1, 3), (2, 3)]),
    frames=stretch,
)  # fmt: skip
def test_two_markers_that_are_exchanged_are_put_back(markers, seed, pair, frames):
    points = walking(markers, seed)
    spoiled = points.copy()
    spoiled[np.ix_(frames, pair)] = spoiled[np.ix_(frames, pair[::-1])]
    got, strays = mended(spoiled)
    assert [(s.kind, s.markers) for s in strays] == [("exchanged", tuple(NAMES[i] for i in pair))]
    np.testing.assert_array_equal(np.flatnonzero(strays[0].frames), frames)
    np.testing.assert_array_equal(got.positions, points)


def test_two_of_five_that_jump_at_once_are_left_out():
    points = walking(5, 3)
    spoiled = points.copy()
    spoiled[40:45, 1] += [0.08, 0.02, -0.06]
    spoiled[40:45, 4] += [-0.03, 0.09, 0.05]
    (stray,) = mended(spoiled)[1]
    assert (stray.kind, stray.markers) == ("left out", ("B", "E"))
    assert stray.in_words() == (
        "B, E left out in frames 41 to 45 of 150 (counted from 1): astray from the markers beside"
    )


def test_with_three_markers_nothing_tells_which():
    points = walking(3, 1)
    spoiled = points.copy()
    spoiled[60:63, 1] += [0.05, 0.0, 0.0]
    got, (stray,) = mended(spoiled)
    assert (stray.kind, stray.markers) == ("unexplained", ("A", "B", "C"))
    np.testing.assert_array_equal(np.flatnonzero(stray.frames), [60, 61, 62])
    np.testing.assert_array_equal(got.positions, spoiled)
    assert "frames 61 to 63" in stray.in_words()
    assert stray.in_words().endswith("with three markers nothing tells which is astray")


def test_markers_of_a_square_do_not_tell_which_two_are_exchanged():
    square = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
    points = np.tile(square, (50, 1, 1)) + NOISE * np.random.default_rng(0).normal(size=(50, 4, 3))
    points[20, [0, 1]] = points[20, [1, 0]]
    markers = MarkerTrajectories(np.arange(50) / 100, NAMES[:4], points)
    (stray,) = mended_cluster(markers, dict(zip(NAMES, square, strict=False)))[1]
    assert stray.kind == "unexplained"


def test_frames_without_three_markers_stay_as_they_are():
    points = walking(4, 2)
    points[30:35, 1:] = np.nan
    points[80:84, 0] += [0.0, 0.08, 0.0]
    got, (stray,) = mended(points)
    assert stray.markers == ("A",)
    np.testing.assert_array_equal(got.missing, np.isnan(points[..., 0]))


@pytest.mark.parametrize("names", [
    ["R_Thigh_Superior", "R_Thigh_Inferior", "R_Thigh_Lateral"],
    ["R_Thigh_Superior", "R_Thigh_Inferior", "R_Thigh_Lateral", "R_Patella"],
    ["L_Thigh_Superior", "L_Thigh_Inferior", "L_Thigh_Lateral", "L_Patella"],
    ["R_Shank_Superior", "R_Shank_Inferior", "R_Shank_Lateral"],
    ["L_Shank_Superior", "L_Shank_Inferior", "L_Shank_Lateral"],
    ["R_Asis", "L_Asis", "R_Psis", "L_Psis"],
])  # fmt: skip
def test_a_persons_gait_is_not_changed(dm_knee, names):
    markers = read_trc(dm_knee / "DM_smooth1_new.trc")
    got, strays = mended_cluster(markers, mean_cluster(markers, names))
    assert strays == []
    np.testing.assert_array_equal(got.positions, markers.select(names).positions)


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_the_rigs_recordings_are_not_changed(case):
    markers = read_trc(recording_files(case)[0])
    for cluster in (rig.TIBIA_MARKERS, rig.PATELLA_MARKERS):
        assert mended_cluster(markers, cluster)[1] == []
