"""Frames in which a recorded bone jumps out and back: filled, and healthy knees kept, wherever their frames are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.mocap import PoseSeries, mended_bones, read_poses

N, RATE = 120, 100.0
T = np.arange(N) / RATE
LIMITS = {"max_gap_s": 0.1, "speed": 0.25, "spin": 25.0}


def knee(*, fastest: float = 6.0, shank: float = 0.4, noise: float = 2e-4, seed: int = 0):
    """Femur and tibia of a walking knee, bent at up to some speed [rad/s]: frames at the hip, and down the shank."""
    random = np.random.default_rng(seed)
    thigh = Rotation.from_rotvec(np.outer(np.sin(6 * T), [0.05, 0.4, 0.02]))
    hip = np.stack([1.2 * T, 0.03 * np.sin(12 * T), 0.9 + 0.02 * np.sin(10 * T)], axis=1)
    flexion = 1.1 / (1 + np.exp(-4 * fastest / 1.1 * (T - 0.6)))  # at its fastest in the middle
    bend = Rotation.from_rotvec(np.stack([0.05 * np.sin(5 * T), -flexion, 0.1 * flexion], axis=1))
    center = hip + thigh.apply([-0.4, 0.0, 0.0]) + thigh.apply(np.outer(flexion, [0.002, 0.0, -0.012]))  # rolls back
    shin = thigh * bend
    down = center + shin.apply([-shank, 0.0, 0.0])

    def poses(places, turns, name):
        wobble = Rotation.from_rotvec(5 * noise * random.normal(size=(N, 3)))
        return PoseSeries(T, places + noise * random.normal(size=(N, 3)), (turns * wobble).as_quat(scalar_first=True),
                          source=name)  # fmt: skip

    return poses(hip, thigh, "femur"), poses(down, shin, "tibia")


def spoiled(poses: PoseSeries, frames, angle: float, away: float) -> PoseSeries:
    turn = np.zeros((N, 3))
    turn[frames] = np.radians(angle) * np.array([0.3, 0.9, -0.3]) / np.linalg.norm([0.3, 0.9, -0.3])
    places = poses.positions.copy()
    places[frames] += [0.0, away, 0.0]
    turned = Rotation.from_quat(poses.quaternions, scalar_first=True) * Rotation.from_rotvec(turn)
    return replace(poses, positions=places, quaternions=turned.as_quat(scalar_first=True))


@pytest.mark.parametrize("fastest", [1.0, 6.0, 15.0, 30.0])  # a slow bend, gait, a kick
@pytest.mark.parametrize("shank", [0.0, 0.4])
def test_a_healthy_knee_is_not_changed(fastest, shank):
    for seed in range(3):
        femur, tibia = knee(fastest=fastest, shank=shank, seed=seed)
        found = mended_bones(femur, tibia, **LIMITS)
        assert found[2] == []
        assert found[:2] == (femur, tibia)
        assert mended_bones(None, tibia.relative_to(femur), **LIMITS)[2] == []


@settings(max_examples=25, deadline=None)
@given(
    bone=st.integers(0, 1),
    first=st.integers(5, N - 15),
    count=st.integers(1, 10),
    wrong=st.sampled_from([(175.0, 0.0), (60.0, 0.0), (0.0, 0.04), (20.0, -0.05)]),
    seed=st.integers(0, 2**31),
)
def test_the_bone_that_jumps_is_filled_where_it_does(bone, first, count, wrong, seed):
    true = knee(seed=seed)
    frames = np.arange(first, first + count)
    bad = [spoiled(p, frames, *wrong) if i == bone else p for i, p in enumerate(true)]
    *got, words = mended_bones(bad[0], bad[1], **LIMITS)
    named = f"frames {first + 1} to {first + count}" if count > 1 else f"frame {first + 1}"
    assert words == [f"{('femur', 'tibia')[bone]}: {named} of 120 (counted from 1) filled by a spline: it jumps there "
                     "out and back"]  # fmt: skip
    mended, other = got[bone], got[1 - bone]
    assert mended is not None
    assert other is true[1 - bone]
    kept = np.delete(np.arange(N), frames)
    np.testing.assert_array_equal(mended.positions[kept], bad[bone].positions[kept])
    assert np.linalg.norm(mended.positions - true[bone].positions, axis=1).max() < 1e-2  # a cubic over 0.1 s
    turn = Rotation.from_quat(mended.quaternions, scalar_first=True).inv() * Rotation.from_quat(
        true[bone].quaternions, scalar_first=True
    )
    assert np.degrees(turn.magnitude()).max() < 2.5


def test_both_bones_of_a_fixed_femur_and_several_stretches():
    femur, tibia = knee()
    alone = tibia.relative_to(femur)
    frames = np.array([20, 21, 22, 50, 80, 81])
    _, got, words = mended_bones(None, spoiled(alone, frames, 90.0, 0.0), **LIMITS)
    assert len(words) == 1
    assert "frames 21 to 23, 51, 81 to 82 of 120" in words[0]
    assert np.linalg.norm(got.positions - alone.positions, axis=1).max() < 4e-3
    both = [spoiled(p, np.array([30, 31]), angle, 0.0) for p, angle in ((femur, 90.0), (tibia, -90.0))]
    assert [w[:5] for w in mended_bones(*both, **LIMITS)[2]] == ["femur", "tibia"]


@pytest.mark.parametrize(
    ("frames", "named"), [(range(40, 51), "frames 41 to 51"), (range(3), "frames 1 to 3"), ([119], "frame 120")]
)
def test_longer_stretches_and_ends_are_refused_by_frames(frames, named):
    femur, tibia = knee()
    with pytest.raises(InputError) as error:
        mended_bones(femur, spoiled(tibia, list(frames), 90.0, 0.0), **LIMITS)
    assert str(error.value).startswith(f"tibia: femur and tibia jump against each other in {named} of 120 (counted")
    assert "at most 0.1 s (max_gap_s) to fill, not at the end" in str(error.value)


def test_measured_and_simulated_knees_are_not_changed(healthy_knee, dm_knee):
    with pytest.warns(match="rows"):
        living = read_poses(healthy_knee / "passive_body_transformations.sto", rate=30)
    assert mended_bones(living["femur_distal_r"], living["tibia_proximal_r"], **LIMITS)[2] == []
    table = read_poses(dm_knee / "passive_flexion_poses.csv")
    assert mended_bones(table["femur"], table["tibia"], **LIMITS)[2] == []
