"""The next equilibrium of a motion without inertia: the same one further on, or another one after a snap.

The state after a snap: the patella at rest on the femur, and the released energy as heat.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Twist
from pftwin.dynamics.equilibrium import RIDGE
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.quasi_static.branch import Branch, Six, components_of
from pftwin.dynamics.quasi_static.newton import newton
from pftwin.dynamics.relaxation import come_to_rest
from pftwin.dynamics.solve import changed_by, solution_changes, tangent_of
from pftwin.dynamics.state import State, displaced_state

LEAST_HELD = 1e-9  # stiffness of every direction, for derivatives alone [N/m]


class NextEquilibrium(NamedTuple):
    """A solution."""

    d: Six  # from the state's pose, or after a snap from the place where the burst ended
    place: State  # where that was
    snapped: Scalar  # 1 after a snap
    residual: Scalar
    remainder: Array  # (6, 6) of the tangent there [N/m]
    trial: tuple[Any, ...]  # memories of the last look

    def landed(self, branch: Branch) -> Branch:
        """The branch that it lies on."""
        origin = jax.tree.map(lambda a, b: jnp.where(self.snapped > 0, a, b), self.place, branch.origin)
        return branch._replace(origin=origin, rates=branch.rates - self.snapped).recalling(self.trial)


@eqx.filter_custom_jvp
def solved(branch: Branch) -> NextEquilibrium:
    """The next equilibrium: the same one further on, or where a snap from the present pose comes to rest."""
    last = branch.origin.carried.displacement
    ahead = components_of(last)
    none = [jnp.zeros_like(a) for a in ahead]
    led = displaced_state(branch.origin, last, last)

    def attempt(now: tuple[NextEquilibrium, Scalar, Scalar]) -> tuple[NextEquilibrium, Scalar, Scalar]:
        _, tries, _ = now
        snapped = jnp.where(tries > 0, 1.0, 0.0).astype(branch.step.dtype)
        place = jax.tree.map(lambda a, b: jnp.where(tries > 0, a, b), led, branch.origin)
        place = come_to_rest(branch.system, place, branch.guide.slowed(0.0), tries > 0)
        there = branch._replace(origin=place, rates=branch.rates - snapped)
        guess = [jnp.where(tries > 0, b, a) for a, b in zip(ahead, none, strict=True)]
        at = newton(there, guess, branch.origin.carried.remainder, tries == 0)
        residual = jnp.where(at.settled, 0.0, at.size)
        again = ~(at.settled & at.stable) & (tries == 0)
        return NextEquilibrium(at.d, place, snapped, residual, at.remainder, at.trial), tries + 1, again

    zero = jnp.zeros_like(branch.step)
    start = NextEquilibrium(ahead, branch.origin, zero, zero, branch.origin.carried.remainder, branch.origin.memories)
    return jax.lax.while_loop(lambda now: now[2], attempt, (start, jnp.zeros((), int), jnp.array(True)))[0]


@solved.def_jvp
def _solved_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """With r(d, p) = 0: dd = -(dr/dd)^-1 (dr/dp) dp, on the branch where the solution lies."""
    (branch,) = primals
    found = solved(branch)
    tangent = tangent_of(lambda d: found.landed(branch).residual(d), found.d)
    # A direction in which nothing holds the patella does not change, even where none is held.
    ridge = (RIDGE * jnp.trace(tangent) - LEAST_HELD) * jnp.eye(6, dtype=tangent.dtype)
    right = changed_by(lambda b: found.landed(b).residual(found.d), branch, tangents[0])
    none = jax.tree.map(lambda a: jnp.zeros_like(a) if eqx.is_inexact_array(a) else None, found)
    return found, none._replace(d=solution_changes(tangent + ridge, right))


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
    entered = ledger.entered(branch.origin, standing, loads, branch.step)
    stored = [sum((x.energy for x in own if x.energy is not None), jnp.zeros(())) for own in (loads, landed)]
    heat, unknown = entered.heat + stored[0] - stored[1], jnp.zeros_like(entered.begun)
    return eqx.tree_at(lambda a: (a.heat, a.begun), entered, (heat, unknown))
