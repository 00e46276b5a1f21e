"""Damped dynamic relaxation to a rest pose, the fallback when the search for an equilibrium fails."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.spatial import Pose, Scalar
from pftwin.dynamics.integrators.linear_implicit import LinearImplicit
from pftwin.dynamics.state import Guide, State, System
from pftwin.dynamics.static_load import LEVER
from pftwin.model.effects.damping import LinearDamping

STEPS = 1500
STEP = 2e-3  # [s]
RATE = 20.0  # [1/s]: overdamps the tendons' slow modes, and settles well within `STEPS`
THROWN = 0.07  # [m]: a patella that ends farther from its start was thrown off by too deep a contact

BURST_STEP, BURST_STEPS = 5e-3, 4000  # step of a burst [s], and the largest number of steps
AWAY = 100  # minimum number of steps of a burst: motion starts slowly where an equilibrium has just ceased to exist
QUIET = 1e-5  # [m/s]: speed below which the patella is at rest


def _damped(system: System) -> System:
    i = system.inertia
    damping = LinearDamping(RATE * system.mass, RATE * jnp.maximum(jnp.maximum(i.x, i.y), i.z), body="ground")
    return eqx.tree_at(lambda s: s.effects, system, (*system.effects, damping))


def relax(system: System, guide: Guide, pose: Pose) -> Pose:
    """The pose of the centre of mass (world) after `STEPS` damped steps."""
    damped = _damped(system)
    state = damped.start(pose, guide)
    step = jnp.asarray(STEP, dtype=pose.position.x.dtype)

    def one_step(_: Scalar, state: State) -> State:
        return LinearImplicit().advance(damped, state, lambda _: guide, step)[0]

    state = jax.lax.fori_loop(0, STEPS, one_step, state)
    return Pose(state.position, state.orientation)


def ended_far_away(before: Pose, after: Pose) -> np.ndarray:
    """Whether relaxation ended too far from its start, or not finite, to be usable. Runs on the host."""
    displacement = np.asarray(after.position.array()) - np.asarray(before.position.array())
    return ~(np.linalg.norm(displacement, axis=-1) < THROWN)


def come_to_rest(system: System, state: State, guide: Guide, moves: Scalar) -> State:
    """Releases the patella from rest at its pose, on guided bodies at rest, until it stops; returns the rest state.

    What the integrator carries is unchanged. Where `moves` is False, the state is returned unchanged.
    """
    damped = _damped(system)
    step = jnp.asarray(BURST_STEP, dtype=state.position.x.dtype)
    zero = jax.tree.map(jnp.zeros_like, state.velocity)
    memories = (*state.memories, None)
    at_rest = eqx.tree_at(lambda s: (s.velocity, s.spin, s.memories), state, (zero, zero, memories))

    def one_step(now: tuple[State, Scalar, Scalar]) -> tuple[State, Scalar, Scalar]:
        after, _ = LinearImplicit().advance(damped, now[0], lambda _: guide, step)
        faster = (after.velocity - now[0].velocity).norm() + LEVER * (after.spin - now[0].spin).norm()
        speed = after.velocity.norm() + LEVER * after.spin.norm() + faster
        return after, now[1] + 1, (speed > QUIET) | (now[1] < AWAY)

    rested, _, _ = jax.lax.while_loop(
        lambda now: now[2] & (now[1] < BURST_STEPS), one_step, (at_rest, jnp.zeros((), int), moves)
    )
    rested = eqx.tree_at(lambda s: (s.velocity, s.spin, s.memories), rested, (zero, zero, rested.memories[:-1]))
    return jax.tree.map(lambda a, b: jnp.where(moves, a, b), rested, state)
