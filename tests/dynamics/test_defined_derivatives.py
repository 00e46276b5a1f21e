"""Derivatives of an equilibrium and of a Newmark step under a force without a potential, against differences.

Under a force that follows the body the tangent is not symmetric, and off equilibrium's axes no row of it is another's:
a tangent that is turned over, made symmetric, or that of stiff terms alone, gives other derivatives.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scenes import J, gravity, still_guide, still_guide_at, tendon, vec

from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3, Wrench
from pftwin.dynamics.equilibrium import solve_equilibrium
from pftwin.dynamics.integrators import Newmark
from pftwin.dynamics.state import System
from pftwin.dynamics.static_load import LEVER, displaced_pose, look_around, patella_at_rest
from pftwin.model.effects.base import Effect, Instant, Load


class Follower(Effect):
    """A force fixed in the body, at one of its points: it has no potential."""

    force: Scalar
    direction: Vec3  # patella axes
    arm: Vec3

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        push = self.force * self.direction
        return Load(wrench=Wrench(now.patella.rotation.apply(push), self.arm.cross(push))), memory


def held(theta: jax.Array, springs: int = 6) -> System:
    """Springs every which way and a follower, by its force [N] and a spring's stiffness, relative."""
    rng = np.random.default_rng(2)
    lines = []
    for k in range(springs):
        on, way = rng.normal(size=3) * 0.02, rng.normal(size=3)
        way = 0.08 * way / np.linalg.norm(way)
        stiffness = 800.0 * (1 + 0.2 * k) * (1 + theta[1] * float(k == 0))
        lines.append(tendon(stiffness, 0.06, 2.0, on, on + way, name=f"spring {k}"))
    follower = Follower(20.0 * (1 + theta[0]), vec(0.3, -0.5, 0.8), vec(0.01, 0.015, -0.004), name="follower")
    return System(J(0.12), vec(3e-5, 6e-5, 4e-5), (*lines, gravity(), follower))


GUESS = Pose(vec(0, 0, 0), Quaternion.identity())
ZERO = jnp.zeros(2)


@jax.jit
def rest(theta):
    found = solve_equilibrium(held(theta), still_guide(), GUESS)
    return jnp.concatenate([found.pose.position.array(), found.pose.orientation.array()])


def differences(function, h: float) -> np.ndarray:
    """Central, (values, parameters)."""
    return np.stack([(function(h * e) - function(-h * e)) / (2 * h) for e in jnp.eye(2)], axis=1)


def test_the_tangent_of_a_load_at_rest_is_its_difference_quotient_with_all_its_asymmetry():
    pose = Pose(vec(0.003, -0.002, 0.004), Quaternion.from_rotation_vector(vec(0.2, -0.1, 0.3)))
    sys, guide = held(ZERO), still_guide()

    @jax.jit
    def seen(like):
        there = look_around(
            sys,
            lambda d: patella_at_rest(guide, displaced_pose(pose, d)),
            sys.guess(patella_at_rest(guide, pose)),
            like,
        )
        return there.tangent(), there.residual()

    @jax.jit
    def load(d):
        """By a rotation vector and displacement, written out."""
        turn = Quaternion.from_rotation_vector((1 / LEVER) * Vec3.from_array(d[3:]))
        at = patella_at_rest(guide, Pose(pose.position + Vec3.from_array(d[:3]), pose.orientation * turn))
        total = [e.load(at, None)[0].total() for e in sys.effects]
        return sum(jnp.concatenate([w.force.array(), w.moment.array() / LEVER]) for w in total)

    tangent, residual = seen(J(0.0))
    exact = -np.asarray(jax.jacfwd(load)(jnp.zeros(6)))
    size = np.abs(exact).max()
    np.testing.assert_allclose(tangent, exact, atol=1e-5 * size)
    np.testing.assert_allclose(residual, load(jnp.zeros(6)), rtol=1e-12)
    assert np.abs(exact - exact.T).max() > 0.05 * size  # or a mistaken transpose would not show


def test_an_equilibrium_follows_what_it_is_made_of():
    slopes = np.asarray(jax.jit(jax.jacfwd(rest))(ZERO))
    expected = differences(rest, 1e-4)
    for k in range(2):
        np.testing.assert_allclose(slopes[:, k], expected[:, k], rtol=1e-4, atol=1e-5 * np.abs(expected[:, k]).max())
    assert np.abs(expected[:3, 0]).max() > 1e-4  # tenths of a millimetre by a doubled force


@jax.jit
def after_a_step(theta, change):
    """Position, orientation and velocities by the damped method, from a turned, moving start, and their change."""
    guide, step = still_guide(), J(2e-3)
    pose = Pose(vec(0.003, -0.002, 0.004), Quaternion.from_rotation_vector(vec(0.2, -0.1, 0.3)))
    integrator = Newmark(rho=0.5)

    def end(theta):
        sys = held(theta, 1)
        state = eqx.tree_at(
            lambda s: (s.velocity, s.spin), sys.start(pose, guide), (vec(0.1, -0.2, 0.15), vec(3.0, -5.0, 4.0))
        )
        state = integrator.begin(sys, state, guide, step)
        state, _ = integrator.advance(sys, state, still_guide_at, step, None)
        return jnp.concatenate([v.array() for v in (state.position, state.orientation, state.velocity, state.spin)])

    return jax.jvp(end, (theta,), (change,))


def test_a_newmark_step_follows_what_acts_in_it():
    slopes = np.stack([after_a_step(ZERO, e)[1] for e in jnp.eye(2)], axis=1)
    expected = differences(lambda theta: after_a_step(theta, ZERO)[0], 1e-4)
    for rows in (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)):  # each on its own scale
        size = np.abs(expected[rows]).max()
        np.testing.assert_allclose(slopes[rows], expected[rows], atol=1e-5 * size)
        assert size > 1e-7
