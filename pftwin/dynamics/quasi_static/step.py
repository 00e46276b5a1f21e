r"""Quasi-static motion without inertia: the loads of all effects, damping included, balance at the end of every step.

With d the displacement over a step, d_last that over the one before it and h the step,

    F(q exp(d), v, t_end) = 0,      v = (d - s d_last) / ((1 - s) h)

is solved for d by Newton's method, started from d_last (continuation). s = 1/3 makes v the backward difference of
second order (BDF2); the first step, and the first after a snap, has s = 0. If there is no equilibrium nearby, or it is
not stable at rest, the patella snaps: a damped dynamic burst (`pftwin.dynamics.relaxation`) moves it from the
extrapolated pose, with guided bodies at rest, until it comes to rest. See docs/physics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Twist
from pftwin.dynamics.equilibrium import RIDGE
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_solver_state
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.quasi_static.branch import Branch, components_of, displacement_of
from pftwin.dynamics.quasi_static.newton import newton
from pftwin.dynamics.relaxation import come_to_rest
from pftwin.dynamics.solve import Six, changed_by, solution_changes, tangent_of
from pftwin.dynamics.state import Guide, GuideAt, State, System, displaced_state

LEAST_HELD = 1e-9  # stiffness added to every direction, for derivatives only [N/m]


class QuasiStaticStep(NamedTuple):
    """What the quasi-static integrator carries from step to step."""

    displacement: Twist  # d_last
    share: Scalar  # s of the next step
    remainder: Array  # (6, 6) of the last tangent [N/m]: see `newton`
    snaps: Scalar  # number since the start
    residual: Scalar  # norm of the residual if above the tolerance, else 0 [N]


class NextEquilibrium(NamedTuple):
    """Solution of a step."""

    d: Six  # displacement from the state's pose or, after a snap, from the end of the burst
    place: State  # end of the burst
    snapped: Scalar  # 1 after a snap
    residual: Scalar
    remainder: Array  # (6, 6) of the tangent there [N/m]
    trial: tuple[Any, ...]  # memories after the last evaluation

    def landed(self, branch: Branch) -> Branch:
        """The branch of this solution, with `d` relative to its origin."""
        origin = jax.tree.map(lambda a, b: jnp.where(self.snapped > 0, a, b), self.place, branch.origin)
        memories = branch.system.refined(origin.memories, self.trial)
        origin = eqx.tree_at(lambda s: s.memories, origin, memories)
        return branch._replace(origin=origin, rates=branch.rates - self.snapped)


@eqx.filter_custom_jvp
def solved(branch: Branch) -> NextEquilibrium:
    """The next equilibrium: the continuation of the present one or, after a snap, the one where the burst ends."""
    last = branch.origin.solver_state.displacement
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
        at = newton(there, guess, branch.origin.solver_state.remainder, tries == 0)
        residual = jnp.where(at.settled, 0.0, at.size)
        retry = ~(at.settled & at.stable) & (tries == 0)
        return NextEquilibrium(at.d, place, snapped, residual, at.remainder, at.trial), tries + 1, retry

    zero = jnp.zeros_like(branch.step)
    origin = branch.origin
    start = NextEquilibrium(ahead, origin, zero, zero, origin.solver_state.remainder, origin.memories)
    return jax.lax.while_loop(lambda now: now[2], attempt, (start, jnp.zeros((), int), jnp.array(True)))[0]


@solved.def_jvp
def _solved_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """With r(d, p) = 0: dd = -(dr/dd)^-1 (dr/dp) dp, on the branch of the solution."""
    (branch,) = primals
    found = solved(branch)
    tangent = tangent_of(lambda d: found.landed(branch).residual(d), found.d)
    # A direction without stiffness gets derivative 0, even if no direction has any.
    ridge = (RIDGE * jnp.trace(tangent) - LEAST_HELD) * jnp.eye(6, dtype=tangent.dtype)
    right = changed_by(lambda b: found.landed(b).residual(found.d), branch, tangents[0])
    none = jax.tree.map(lambda a: jnp.zeros_like(a) if eqx.is_inexact_array(a) else None, found)
    return found, none._replace(d=solution_changes(tangent + ridge, right))


def moved_with_femur(branch: Branch, state: State) -> Twist:
    """Displacement over a step of a patella at rest relative to the moving femur."""
    femur = branch.guide.femur
    if femur is None:
        return Twist(state.velocity, state.spin).times(0.0)
    turning = state.orientation.unrotate(femur.angular_velocity)
    return Twist(femur.velocity_at(state.position), turning).times(branch.step)


def over_a_snap(ledger: Ledger, branch: Branch, landed: list[Any]) -> Ledger:
    """The ledger after a snap: guided bodies move first, then the patella, whose loss of stored energy is heat."""
    held = branch._replace(rates=jnp.zeros_like(branch.rates))
    standing = held.after([jnp.zeros_like(branch.step)] * 6)
    loads, _ = branch.system.loads(branch.guide.instant(standing.patella(), 0.0), branch.origin.memories)
    after_step = ledger.after_step(branch.origin, standing, loads, branch.step)
    stored = [sum((x.energy for x in own if x.energy is not None), jnp.zeros(())) for own in (loads, landed)]
    heat, unknown = after_step.heat + stored[0] - stored[1], jnp.zeros_like(after_step.begun)
    return eqx.tree_at(lambda a: (a.heat, a.begun), after_step, (heat, unknown))


@dataclass(frozen=True)
class QuasiStatic(Integrator):
    """Quasi-static motion without inertia: see the module `pftwin.dynamics.quasi_static.step`."""

    name: ClassVar[str] = "quasi_static"
    order: ClassVar[int] = 2
    inertia: ClassVar[bool] = False

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """See `Integrator`: the first step's guess follows from the state's velocity."""
        zero = jnp.zeros_like(state.position.x)
        displacement = Twist(state.velocity, state.spin).times(step)
        return with_solver_state(state, QuasiStaticStep(displacement, zero, jnp.zeros((6, 6), zero.dtype), zero, zero))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        branch = Branch(system, state, guide_at(1.0), step, jnp.ones_like(step))
        found = solved(branch)
        landed = found.landed(branch)
        after = landed.after(found.d)
        loads, memories = system.loads(landed.instant(found.d), landed.origin.memories)
        snapped = found.snapped > 0
        displacement = jax.tree.map(
            lambda a, b: jnp.where(snapped, a, b), moved_with_femur(branch, after), displacement_of(found.d)
        )
        share = jnp.where(snapped, 0.0, jnp.full_like(step, 1 / 3))
        remainder = jax.lax.stop_gradient(found.remainder)
        snaps = state.solver_state.snaps + found.snapped
        solver_state = QuasiStaticStep(displacement, share, remainder, snaps, found.residual)
        after = eqx.tree_at(lambda s: (s.memories, s.solver_state), after, (memories, solver_state))
        if ledger is None:
            return after, None
        regular = ledger.after_step(state, after, loads, step)
        return after, jax.tree.map(lambda a, b: jnp.where(snapped, a, b), over_a_snap(ledger, branch, loads), regular)
