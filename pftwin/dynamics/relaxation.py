"""Where heavily damped dynamics comes to rest: the fallback when the search for an equilibrium does not end."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.dynamics.linear_implicit import linear_implicit
from pftwin.dynamics.state import Guide, System
from pftwin.effects.damping import LinearDamping
from pftwin.spatial import Pose

STEPS = 1500
STEP = 2e-3  # [s]
RATE = 20.0  # [1/s]: overdamped against the tendons' slow modes, settled well within the time given


def relax(system: System, guide: Guide, pose: Pose) -> Pose:
    """The pose after a while, from another; of the centre of mass, in the world."""
    i = system.inertia
    damping = LinearDamping(RATE * system.mass, RATE * jnp.maximum(jnp.maximum(i.x, i.y), i.z), body="ground")
    damped = eqx.tree_at(lambda s: s.effects, system, (*system.effects, damping))
    state = damped.start(pose, guide)
    step = jnp.asarray(STEP, dtype=pose.position.x.dtype)
    state = jax.lax.fori_loop(0, STEPS, lambda _, s: linear_implicit(damped, s, lambda _: guide, step)[0], state)
    return Pose(state.position, state.orientation)
