"""Prescribed motion: exact poses at the frames, C2 between them, velocities that are the pose's derivatives."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.files.mocap import PoseSeries
from pftwin.model.motion import Frame, KneeMotion, SegmentMotion

N = 60
T = 0.3 + np.arange(N) / 100


def series(seed=0, times: np.ndarray = T, source="tibia"):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    phase = 5 * times[:, None]
    positions = 0.1 * (a[0] * np.sin(phase) + a[1] * np.cos(1.3 * phase))
    vectors = b[0] * np.sin(phase) + b[1] * np.cos(0.7 * phase)
    quaternions = Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    return PoseSeries(times, positions, quaternions, source=source)


frames = eqx.filter_jit(lambda motion, t: motion.frames(t))


def test_the_recorded_poses_are_met():
    poses = series()
    f = frames(SegmentMotion.fit(poses), jnp.asarray(T))
    np.testing.assert_allclose(f.origin.array(), poses.positions, atol=1e-14)
    np.testing.assert_allclose(f.rotation.array(), poses.matrices(), atol=1e-14)


def test_a_steady_spin_has_its_angular_velocity():
    omega = np.array([0.4, -1.0, 2.0])
    quaternions = Rotation.from_rotvec(T[:, None] * omega).as_quat(scalar_first=True)
    motion = SegmentMotion.fit(PoseSeries(T, T[:, None] * [1.0, 2, 3] + 1, quaternions))
    f = frames(motion, jnp.asarray(np.linspace(T[0], T[-1], 333)))
    np.testing.assert_allclose(f.angular_velocity.array(), np.tile(omega, (333, 1)), atol=2e-5)
    np.testing.assert_allclose(f.velocity.array(), np.tile([1.0, 2, 3], (333, 1)), atol=1e-10)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), share=st.floats(0.01, 0.99))
def test_velocities_are_the_derivatives_of_the_pose(seed, share):
    motion = SegmentMotion.fit(series(seed))
    t, h = T[0] + share * (T[-1] - T[0]), 1e-5
    f = frames(motion, jnp.asarray([t - h, t, t + h]))
    r, p = np.asarray(f.rotation.array()), np.asarray(f.origin.array())
    velocity = (p[2] - p[0]) / (2 * h)
    omega = Rotation.from_matrix(r[2] @ r[0].T).as_rotvec() / (2 * h)
    np.testing.assert_allclose(f.velocity.array()[1], velocity, atol=2e-6)
    np.testing.assert_allclose(f.angular_velocity.array()[1], omega, atol=2e-5)


def test_the_motion_is_twice_continuously_differentiable_at_the_knots():
    motion = SegmentMotion.fit(series())

    def state(t):
        f = motion.frames(t)
        return jnp.concatenate([f.velocity.array(), f.angular_velocity.array()])

    acceleration = jax.jit(jax.vmap(jax.jacfwd(state)))
    knots, eps = T[1:-1], 1e-9
    before, after = acceleration(jnp.asarray(knots - eps)), acceleration(jnp.asarray(knots + eps))
    np.testing.assert_allclose(before, after, atol=2e-5)
    assert np.abs(before).max() > 1
    f, g = frames(motion, jnp.asarray(knots - eps)), frames(motion, jnp.asarray(knots + eps))
    np.testing.assert_allclose(f.rotation.array(), g.rotation.array(), atol=1e-7)
    np.testing.assert_allclose(f.velocity.array(), g.velocity.array(), atol=1e-6)


def test_a_body_fixed_point_moves_with_velocity_at():
    motion = SegmentMotion.fit(series(4))
    p = Vec3.from_array(jnp.array([0.05, -0.02, 0.4]))
    times, h = jnp.asarray(np.linspace(0.31, 0.88, 20)), 1e-5
    now, before, after = (frames(motion, times + s) for s in (0.0, -h, h))
    difference = (after.point(p) - before.point(p)) * (1 / (2 * h))
    place = now.point(p)
    np.testing.assert_allclose(now.velocity_at(place).array(), difference.array(), atol=2e-5)
    local = now.to_local(place).array()
    np.testing.assert_allclose(local, np.tile(p.array(), (20, 1)), atol=1e-14)
    turned = now.local_direction(now.direction(p)).array()
    np.testing.assert_allclose(turned, np.tile(p.array(), (20, 1)), atol=1e-14)


def test_the_world_is_a_frame_at_rest():
    w, p = Frame.world(), Vec3.from_array(jnp.array([1.0, 2, 3]))
    np.testing.assert_array_equal(w.point(p).array(), p.array())
    np.testing.assert_array_equal(w.velocity_at(p).array(), np.zeros(3))


def test_times_of_any_shape_and_gradients_with_respect_to_leaves():
    motion = SegmentMotion.fit(series())
    assert frames(motion, 0.5).origin.x.shape == ()
    assert frames(motion, jnp.full((2, 3), 0.5)).angular_velocity.z.shape == (2, 3)

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def height(m):
        return jnp.sum(m.frames(jnp.asarray([0.4, 0.6])).angular_velocity.x)

    k, step = (2, int(np.searchsorted(T, 0.4)) - 1, 3), 1e-6
    sides = []
    for s in (step, -step):
        coefficients = np.array(motion.quaternion_coefficients)
        coefficients[k] += s
        moved = eqx.tree_at(lambda m: m.quaternion_coefficients, motion, jnp.asarray(coefficients))
        sides.append(float(height(moved)[0]))
    slope = np.asarray(height(motion)[1].quaternion_coefficients)[k]
    assert slope == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-6, abs=1e-9)


def test_the_ends_are_reached_to_within_a_rounding_error():
    poses = series()
    motion = KneeMotion.from_poses(None, poses)
    _, f = frames(motion, jnp.asarray([motion.start_time, motion.end_time, motion.end_time + 1e-12]))
    np.testing.assert_allclose(f.origin.array()[1:], np.tile(poses.positions[-1], (2, 1)), atol=1e-10)
    assert (motion.n_frames, motion.frame_interval, motion.start_time) == (N, 0.01, 0.3)
    np.testing.assert_allclose(motion.times, T, atol=1e-12)


def test_a_fixed_femur_is_the_world():
    tibia = series(1)
    q = Rotation.from_rotvec([0.3, -0.2, 0.9])
    femur = Pose(Vec3.from_array(np.array([0.1, 0.2, 0.3])), Quaternion.from_array(q.as_quat(scalar_first=True)))
    motion = KneeMotion.from_poses(femur, tibia)
    assert motion.femur is None
    nothing, f = frames(motion, jnp.asarray(T))
    assert nothing is None
    np.testing.assert_allclose(f.origin.array(), q.inv().apply(tibia.positions - [0.1, 0.2, 0.3]), atol=1e-12)
    assert len(jax.tree.leaves(motion)) == 3  # the femur costs nothing


def test_a_moving_femur_and_a_fixed_one_give_the_same_relative_motion():
    femur, tibia = series(2, source="femur"), series(3)
    both = KneeMotion.from_poses(femur, tibia)
    relative = KneeMotion.from_poses(None, tibia.relative_to(femur))
    f, t = frames(both, jnp.asarray(T))
    assert f is not None
    _, r = frames(relative, jnp.asarray(T))
    np.testing.assert_allclose(f.to_local(t.origin).array(), r.origin.array(), atol=1e-12)
    seen = f.local_direction(t.velocity_at(t.origin) - f.velocity_at(t.origin))
    np.testing.assert_allclose(seen.array()[5:-5], r.velocity.array()[5:-5], atol=1e-3)


def test_recordings_of_one_rate_share_one_program():
    one = KneeMotion.from_poses(None, series(1, times=np.arange(N) / 100))
    two = KneeMotion.from_poses(None, series(2, times=np.round(np.arange(N) * 0.01 + 1e-13, 9)))
    assert jax.tree.structure(one) == jax.tree.structure(two)


def test_motions_that_cannot_be_used():
    with pytest.raises(
        InputError, match=r"tibia: a motion of 3 frames is shorter than its interpolation needs.*at least 4"
    ):
        KneeMotion.from_poses(None, series(times=T[:3]))
    with pytest.raises(InputError, match="a motion of 2 frames"):
        SegmentMotion.fit(series(times=T[:2]))
    uneven = np.where(np.arange(N) > 20, T + 0.02, T)
    with pytest.raises(InputError, match=r"tibia: times are not evenly spaced: 0\.03 s between rows 21 and 22"):
        KneeMotion.from_poses(None, series(times=uneven))
    with pytest.raises(InputError, match=r"row 1 is at 0\.4 s in femur and at 0\.3 s in tibia"):
        KneeMotion.from_poses(series(times=T + 0.1, source="femur"), series())


def test_single_precision_follows_the_default_float_type():
    with jax.enable_x64(False):
        motion = SegmentMotion.fit(series())
        assert motion.knots.dtype == jnp.float32
        f = frames(motion, jnp.asarray(T, jnp.float32))
        assert f.origin.x.dtype == jnp.float32
        np.testing.assert_allclose(f.origin.array(), series().positions, atol=1e-5)
