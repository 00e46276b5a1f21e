"""Frames of a patella that are out of line: made ones are found, whatever their number, and good ones are kept."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pftwin.files.mocap import PoseSeries, read_poses
from pftwin.files.mocap.bones import in_words, jumps

N, RATE = 60, 30.0


def flexing(noise: float = 3e-4) -> tuple[np.ndarray, Rotation]:
    """A patella that glides 25 mm and turns by 30 deg in 2 s, there and back, with the noise of dynamic MRI."""
    random, phase = np.random.default_rng(4), np.sin(np.linspace(0, np.pi, N))
    places = np.outer(phase, [0.01, -0.025, 0.002]) + [0.04, 0.02, -0.003] + noise * random.normal(size=(N, 3))
    turns = Rotation.from_rotvec(np.outer(phase, [0.05, 0.1, -0.5]) + 20 * noise * random.normal(size=(N, 3)))
    return places, turns


def series(places, turns) -> PoseSeries:
    return PoseSeries(np.arange(N) / RATE, places, turns.as_quat(scalar_first=True), source="knee.sto")


def spoiled(frames, angle: float, away: float) -> PoseSeries:
    """These frames turned by an angle [deg] about an axis of their own, and moved."""
    places, turns = flexing()
    axis = np.array([0.3, 0.9, -0.3]) / np.linalg.norm([0.3, 0.9, -0.3])
    more = np.zeros((N, 3))
    more[frames] = np.radians(angle) * axis
    places[frames] += [0.0, away, 0.0]
    return series(places, turns * Rotation.from_rotvec(more))


def test_a_good_recording_is_not_changed():
    assert not jumps(series(*flexing())).any()
    places, turns = flexing()
    assert not jumps(PoseSeries(np.arange(N) / 2e3, places, turns.as_quat(scalar_first=True))).any()  # 2 s in 30 ms
    assert not jumps(PoseSeries(np.arange(1), places[:1], turns[:1].as_quat(scalar_first=True))).any()


def test_a_patella_that_stands_still_and_then_moves_is_not_changed():
    places, turns = flexing()
    still = np.r_[np.zeros(N, int), np.arange(N)]
    held = PoseSeries(np.arange(2 * N) / RATE, places[still], turns[still].as_quat(scalar_first=True))
    assert not jumps(held).any()


@settings(max_examples=40, deadline=None)
@given(frames=st.sets(st.integers(0, N - 1), min_size=1, max_size=20))
def test_single_frames_that_are_upside_down_are_found(frames):
    wrong = sorted(frames)
    np.testing.assert_array_equal(np.flatnonzero(jumps(spoiled(wrong, 175.0, 0.0))), wrong)


@pytest.mark.parametrize("frames", [range(20, 45), range(12), range(48, 60), [3, 4, 30, 31, 32, 50]])
def test_stretches_are_found(frames):
    for angle, away in ((175.0, 0.0), (0.0, 0.06)):
        np.testing.assert_array_equal(np.flatnonzero(jumps(spoiled(list(frames), angle, away))), list(frames))


def test_a_long_stretch_at_a_high_rate_costs_no_good_frames():
    n, wrong = 1500, np.arange(600, 850)
    places = np.outer(np.sin(np.linspace(0, np.pi, n)), [0.01, -0.025, 0.002])
    turns = np.tile([1.0, 0, 0, 0], (n, 1))
    turns[wrong] = [0.0, 1, 0, 0]
    np.testing.assert_array_equal(np.flatnonzero(jumps(PoseSeries(np.arange(n) / 1e3, places, turns))), wrong)


def test_where_no_frames_are_a_patella_may_move_on():
    times = np.r_[np.arange(30), 30 + 60 + np.arange(30)] / 100
    places = np.outer(times, [0.0, -0.06, 0.0])  # 6 cm/s: 36 mm in the gap
    assert not jumps(PoseSeries(times, places, np.tile([1.0, 0, 0, 0], (60, 1)))).any()


def test_frames_are_named_as_people_count_them():
    odd = np.isin(np.arange(70), [0, 4, 5, 6, 9])
    assert in_words(odd) == "frames 1, 5 to 7, 10"
    assert in_words(np.arange(5) == 2) == "frame 3"
    assert in_words(np.arange(40) % 2 == 0) == "frames 1, 3, 5, 7, 9, 11, 13, 15 and 12 more stretches"


def test_a_living_knees_recording_is_not_changed(healthy_knee):
    with pytest.warns(match="rows"):
        poses = read_poses(healthy_knee / "passive_body_transformations.sto", rate=30)
    assert not jumps(poses["patella_r"].relative_to(poses["femur_distal_r"])).any()
