"""The state after a snap: the patella at rest on the femur, and the released energy as heat."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.spatial import Twist
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.quasi_static.branch import Branch
from pftwin.dynamics.state import State


def carried_along(branch: Branch, state: State) -> Twist:
    """The displacement over a step of a patella at rest on the moving femur."""
    femur = branch.guide.femur
    if femur is None:
        return Twist(state.velocity, state.spin).times(0.0)
    turning = state.orientation.unrotate(femur.angular_velocity)
    return Twist(femur.velocity_at(state.position), turning).times(branch.step)


def over_a_snap(ledger: Ledger, branch: Branch, landed: list[Any]) -> Ledger:
    """Guided bodies move first, then the patella; the stored energy that it loses becomes heat."""
    held = branch._replace(rates=jnp.zeros_like(branch.rates))
    standing = held.after([jnp.zeros_like(branch.step)] * 6)
    loads, _ = branch.system.loads(branch.guide.instant(standing.patella(), 0.0), branch.origin.memories)
    entered = ledger.entered(standing, standing, loads, None, 1.0, branch.step)
    stored = [sum((x.energy for x in own if x.energy is not None), jnp.zeros(())) for own in (loads, landed)]
    return eqx.tree_at(lambda a: a.heat, entered, entered.heat + stored[0] - stored[1])
