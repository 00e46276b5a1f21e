"""Rotation conventions: round trips, scipy's Rotation, clinical signs, derivatives, gimbal lock."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation as ScipyRotation

from pftwin.base import rotations
from pftwin.base.spatial import Quaternion, Vec3

turn = st.floats(-np.pi + 1e-6, np.pi - 1e-6)
floating = st.floats(-np.pi / 2 + 1e-3, np.pi / 2 - 1e-3)
JOINTS = [
    (rotations.patellar_angles, rotations.patellar_orientation, (-1, 1, -1)),
    (rotations.tibiofemoral_angles, rotations.tibiofemoral_orientation, (-1, 1, 1)),
]


def random_angles(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (n, 3))


@pytest.mark.parametrize(("angles_of", "orientation", "signs"), JOINTS)
@settings(deadline=None, max_examples=200)
@given(a=turn, b=floating, c=turn)
def test_round_trip(angles_of, orientation, signs, a, b, c):
    np.testing.assert_allclose(np.array(angles_of(orientation(a, b, c))), [a, b, c], atol=1e-9)


@pytest.mark.parametrize(("angles_of", "orientation", "signs"), JOINTS)
def test_agrees_with_scipy_both_ways(angles_of, orientation, signs):
    angles = random_angles()
    reference = ScipyRotation.from_euler("YZX", angles * signs)
    ours = orientation(*(jnp.asarray(column) for column in angles.T))
    np.testing.assert_allclose(ours.rotation().array(), reference.as_matrix(), atol=1e-14)
    q = Quaternion.from_array(jnp.asarray(reference.as_quat(scalar_first=True)))
    np.testing.assert_allclose(np.stack(angles_of(q), axis=1), angles, atol=1e-12)


def test_host_and_device_agree_and_host_stays_in_numpy():
    q = ScipyRotation.from_euler("YZX", random_angles()).as_quat(scalar_first=True)
    host = rotations.patellar_angles(Quaternion(*q.T))
    device = rotations.patellar_angles(Quaternion.from_array(jnp.asarray(q)))
    assert all(isinstance(a, np.ndarray) and a.dtype == np.float64 for a in host)
    np.testing.assert_allclose(np.stack(host), np.stack(device), atol=1e-14)


def test_signs_of_the_patella():
    lateral, anterior, inferior_pole = Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0), Vec3(-1.0, 0.0, 0.0)
    flexed = rotations.patellar_orientation(0.3, 0.0, 0.0).rotate(anterior)
    assert flexed.x < 0  # the front turns distally
    rotated = rotations.patellar_orientation(0.0, 0.3, 0.0).rotate(inferior_pole)
    assert rotated.y < 0  # the inferior pole moves medially
    tilted = rotations.patellar_orientation(0.0, 0.0, 0.3).rotate(lateral)
    assert tilted.z < 0  # the lateral edge moves posteriorly


def test_signs_of_the_tibia():
    distal, anterior = Vec3(-1.0, 0.0, 0.0), Vec3(0.0, 0.0, 1.0)
    assert rotations.tibiofemoral_orientation(0.3, 0.0, 0.0).rotate(distal).z < 0  # posteriorly
    assert rotations.tibiofemoral_orientation(0.0, 0.3, 0.0).rotate(distal).y < 0  # medially
    assert rotations.tibiofemoral_orientation(0.0, 0.0, 0.3).rotate(anterior).y < 0  # medially


def test_patella_follows_the_tibia_in_flexion():
    tibia = rotations.tibiofemoral_orientation(0.7, 0.0, 0.0)
    assert rotations.patellar_angles(tibia).flexion == pytest.approx(0.7)


def test_jacobian_at_the_identity_is_exact():
    def angles(v):
        return jnp.stack(rotations.patellar_angles(Quaternion.from_rotation_vector(Vec3(v[0], v[1], v[2]))))

    expected = [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(derivative(angles)(jnp.zeros(3)), expected, atol=1e-12)


def test_derivatives_agree_with_finite_differences():
    def angles(v):
        return jnp.stack(rotations.tibiofemoral_angles(Quaternion.from_rotation_vector(Vec3(v[0], v[1], v[2]))))

    at, small = jnp.asarray([0.4, -0.9, 0.3]), 1e-6
    numeric = np.stack([(angles(at + d) - angles(at - d)) / (2 * small) for d in small * np.eye(3)], axis=1)
    np.testing.assert_allclose(jax.jacfwd(angles)(at), numeric, atol=1e-8)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("turns", [(0.0, 0.0), (0.7, 0.0), (0.4, -0.6), (-2.0, 0.5)])
def test_gimbal_lock_keeps_the_orientation(side, turns):
    q = rotations.patellar_orientation(jnp.asarray(turns[0]), jnp.asarray(side * np.pi / 2), jnp.asarray(turns[1]))
    found = rotations.patellar_angles(q)
    assert found.tilt == 0
    back = rotations.patellar_orientation(*found)
    np.testing.assert_allclose(back.rotation().array(), q.rotation().array(), atol=1e-7)
    gradient = jax.jacrev(lambda p: rotations.patellar_angles(p))(q)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
