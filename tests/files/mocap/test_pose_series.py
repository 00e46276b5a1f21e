"""Pose series: validation, composition, mirroring."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.files.mocap import PoseSeries, mirror_left_poses

N = 12
T = np.arange(N) / 100


def random_series(seed, **options):
    rng = np.random.default_rng(seed)
    quaternions = Rotation.random(N, rng=rng).as_quat(scalar_first=True)
    return PoseSeries(T, rng.normal(size=(N, 3)), quaternions, **options)


def homogeneous(s):
    out = np.tile(np.eye(4), (N, 1, 1))
    out[:, :3, :3], out[:, :3, 3] = s.matrices(), s.positions
    return out


def test_signs_are_continuous_and_rounding_is_normalised():
    angle = np.linspace(0, 4 * np.pi, N)
    q = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], axis=1)
    scrambled = q * np.where(np.arange(N) % 3 == 1, -1.0, 1.0)[:, None] * 1.0004
    s = PoseSeries(T, np.zeros((N, 3)), scrambled)
    assert (np.sum(s.quaternions[1:] * s.quaternions[:-1], axis=1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(s.quaternions, axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(s.quaternions, q, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t, p, q: (t, p, q * np.where(np.arange(N) == 7, 1.01, 1)[:, None]),
            "row 8: a quaternion of length 1.01",
        ),
        (lambda t, p, q: (t, p, q * 0), "row 1: a quaternion of length 0"),
        (lambda t, p, q: (t, p * np.where(np.arange(N) == 2, np.nan, 1)[:, None], q), "row 3 of the positions"),
        (lambda t, p, q: (t, p, q[:, :3]), r"quaternions of shape \(12, 3\)"),
        (lambda t, p, q: (np.zeros(N), p, q), "row 2 repeats the time"),
    ],
)
def test_bad_series(change, message):
    s = random_series(0)
    with pytest.raises(InputError, match=message):
        PoseSeries(*change(s.times, s.positions, s.quaternions))


def test_composition_agrees_with_matrices():
    a, b = random_series(1, residual_rms=np.ones(N)), random_series(2)
    np.testing.assert_allclose(
        homogeneous(a.relative_to(b)), np.linalg.inv(homogeneous(b)) @ homogeneous(a), atol=1e-12
    )
    q = Rotation.from_rotvec([0.3, -0.2, 0.9])
    fixed = Pose(Vec3.from_array(np.array([0.1, 0.2, 0.3])), Quaternion.from_array(q.as_quat(scalar_first=True)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = q.as_matrix(), [0.1, 0.2, 0.3]
    np.testing.assert_allclose(homogeneous(a.compose(fixed)), homogeneous(a) @ matrix, atol=1e-12)
    np.testing.assert_allclose(homogeneous(a.seen_from(fixed)), np.linalg.inv(matrix) @ homogeneous(a), atol=1e-12)
    assert a.compose(fixed).residual_rms is not None
    assert a.between(0.02, 0.04).times.size == 3


def test_bodies_have_to_share_their_times():
    a = random_series(1)
    other = PoseSeries(np.where(T > 0.025, T * 1.4, T), a.positions, a.quaternions, source="tibia")
    with pytest.raises(InputError, match=r"row 4 is at 0\.03 s in poses and at 0\.042 s in tibia"):
        a.relative_to(other)
    with pytest.raises(InputError, match="12 frames in poses, 3 in poses"):
        a.relative_to(a.between(0.02, 0.04))


def test_mirroring_is_its_own_inverse_and_keeps_distances():
    s = random_series(3)
    m = mirror_left_poses(s, medial_lateral="z", body_medial_lateral="y")
    again = mirror_left_poses(m, medial_lateral="z", body_medial_lateral="y")
    np.testing.assert_allclose(homogeneous(again), homogeneous(s), atol=1e-12)
    # a body point, mirrored in the body, is found at the mirrored place in the world
    p = np.array([0.03, -0.02, 0.05])
    world = s.positions + s.matrices() @ p
    np.testing.assert_allclose(m.positions + m.matrices() @ (p * [1, -1, 1]), world * [1, 1, -1], atol=1e-12)
