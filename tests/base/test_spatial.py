"""Vectors and rotations against scipy's Rotation; round trips; derivatives that stay finite at identity and zero."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation as ScipyRotation

from pftwin.base.spatial import Pose, Quaternion, Rotation, Twist, Vec3, Wrench, safe_sqrt

_RNG = np.random.default_rng(3)
N = 200
SCIPY = ScipyRotation.random(N, rng=_RNG)
QUATERNIONS = Quaternion.from_array(SCIPY.as_quat(scalar_first=True))
POINTS = _RNG.normal(size=(N, 3))
vectors = arrays(float, 3, elements=st.floats(-10, 10, allow_subnormal=False))


def same_rotation(q: Quaternion, expected: ScipyRotation, atol: float = 1e-12) -> bool:
    turn = ScipyRotation.from_quat(np.asarray(q.array()), scalar_first=True).inv() * expected
    return float(np.max(turn.magnitude())) < atol


def vector(v) -> Vec3:
    return Vec3.from_array(jnp.asarray(v))


def test_products_of_vectors():
    a, b = vector(POINTS), vector(POINTS[::-1])
    np.testing.assert_allclose(a.dot(b), np.sum(POINTS * POINTS[::-1], 1))
    np.testing.assert_allclose(a.cross(b).array(), np.cross(POINTS, POINTS[::-1]))
    np.testing.assert_allclose(a.norm(), np.linalg.norm(POINTS, axis=1))
    np.testing.assert_allclose(a.sum().array(), POINTS.sum(0))
    np.testing.assert_allclose((2.0 * a - b * 3.0 + -a).array(), POINTS - 3 * POINTS[::-1])


def test_perpendiculars_complete_a_right_handed_frame_everywhere():
    units = np.concatenate([POINTS / np.linalg.norm(POINTS, axis=1)[:, None], np.eye(3), -np.eye(3)])
    one, two = vector(units).perpendiculars()
    frame = np.stack([np.asarray(one.array()), np.asarray(two.array()), units], axis=1)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frame), 1, atol=1e-14)


def test_quaternions_agree_with_scipy():
    q, p, other = QUATERNIONS, vector(POINTS), QUATERNIONS.conjugate()
    np.testing.assert_allclose(q.rotation().array(), SCIPY.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(q.rotate(p).array(), SCIPY.apply(POINTS), atol=1e-14)
    np.testing.assert_allclose(q.unrotate(p).array(), SCIPY.inv().apply(POINTS), atol=1e-14)
    np.testing.assert_allclose(q.rotation_vector().array(), SCIPY.as_rotvec(), atol=1e-12)
    shuffled = Quaternion.from_array(q.array()[::-1])
    assert same_rotation(q * shuffled, SCIPY * SCIPY[::-1])
    assert same_rotation(other, SCIPY.inv())
    assert same_rotation(Quaternion.from_rotation_vector(vector(SCIPY.as_rotvec())), SCIPY)


def test_a_matrix_becomes_its_quaternion_also_at_half_turns():
    half_turns = ScipyRotation.from_rotvec(np.pi * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, 0.8]]))
    for expected in (SCIPY, half_turns, ScipyRotation.identity(2)):
        q = Quaternion.from_rotation(Rotation.from_array(expected.as_matrix()))
        assert same_rotation(q, expected, 1e-7)
        assert bool(jnp.all(q.w >= 0))


@pytest.mark.parametrize("angle", [1e-3, 1e-4, 9.9e-5, 1e-6, 1e-9, 0.0])
def test_small_turns_keep_every_digit(angle):
    v = angle * np.array([0.6, -0.48, 0.64])
    q = Quaternion.from_rotation_vector(vector(v))
    assert float(q.w) == pytest.approx(np.cos(angle / 2), rel=1e-16)
    np.testing.assert_allclose(q.rotation_vector().array(), v, rtol=1e-14, atol=1e-300)


@settings(max_examples=30, deadline=None)
@given(vectors, vectors, vectors)
def test_poses_compose_and_are_undone(v, p, point):
    pose = Pose(vector(p), Quaternion.from_rotation_vector(vector(v)))
    other = Pose(vector(v), Quaternion.from_rotation_vector(vector(p)))
    x = vector(point)
    for q, expected in (
        (pose.unapply(pose.apply(x)), x),
        ((pose * other).apply(x), pose.apply(other.apply(x))),
    ):
        np.testing.assert_allclose(q.array(), expected.array(), atol=1e-11)


@settings(max_examples=30, deadline=None)
@given(vectors)
def test_the_logarithm_undoes_the_exponential_up_to_a_full_turn(v):
    back = Quaternion.from_rotation_vector(vector(v)).rotation_vector()
    assert float(back.norm()) <= np.pi + 1e-12
    assert same_rotation(Quaternion.from_rotation_vector(back), ScipyRotation.from_rotvec(v), 1e-7)


def test_derivatives_are_finite_at_zero_and_at_the_identity():
    zero = vector(np.zeros(3))
    assert np.all(jax.grad(lambda v: v.norm())(zero).array() == 0)
    assert jax.grad(safe_sqrt)(0.0) == 0

    def there_and_back(v: jnp.ndarray) -> jnp.ndarray:
        return Quaternion.from_rotation_vector(vector(v)).rotation_vector().array()

    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(derivative(there_and_back))(jnp.zeros(3)), np.eye(3), atol=1e-14)
    second = jax.jit(jax.hessian(lambda v: Quaternion.from_rotation_vector(vector(v)).w))(jnp.zeros(3))
    np.testing.assert_allclose(second, -0.25 * np.eye(3), atol=1e-14)
    gradient = jax.jit(jax.jacrev(lambda m: Quaternion.from_rotation(Rotation.from_array(m)).array()))(jnp.eye(3))
    assert np.all(np.isfinite(gradient))


def test_power_of_a_wrench_does_not_depend_on_the_reference_point():
    force, moment, arm, linear, angular = (vector(p) for p in POINTS[:5])
    at_point = Twist(Twist(linear, angular).velocity_at(arm), angular)
    moved = Wrench(force, moment - arm.cross(force))
    assert float(Wrench(force, moment).power(Twist(linear, angular))) == pytest.approx(float(moved.power(at_point)))
    assert float((Wrench(force, moment) + Wrench.zero()).force.x) == float(force.x)


def test_float32_stays_float32():
    v = Vec3.from_array(np.array([0.1, 0.2, 0.3], np.float32))
    q = Quaternion.from_rotation_vector(v)
    leaves = jax.tree.leaves((q, q.rotation(), q.rotation_vector(), q.normalised(), v.norm(), v.cross(v)))
    assert {leaf.dtype for leaf in leaves} == {np.dtype(np.float32)}
    assert Quaternion.from_rotation(q.rotation()).w.dtype == np.float32
