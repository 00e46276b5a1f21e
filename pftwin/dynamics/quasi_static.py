r"""Motion without inertia: at the end of every step the forces of all effects balance, rates and all.

With d the displacement over a step, d_last that over the one before it and h the step,

    F(q exp(d), v, t_end) = 0,      v = (d - s d_last) / ((1 - s) h)

is solved for d by Newton's iteration, started from d_last (continuation). s = 1/3 makes v the backward difference of
second order (BDF2); the first step, and the first after a snap, has s = 0. Guided bodies move with their own
velocities: dashpots, friction and viscoelastic tendons act as they do in the dynamics; only mass and moments of inertia
are left out. In a scene without forces that go by speed this is one static equilibrium per step, exact at any step.

An equilibrium can end: in a fold its tangent loses positive definiteness, and the patella snaps over a facet, out of
its groove or back into it. Where no equilibrium is found nearby, or one that is not stable at rest, the patella goes on
from where the motion has led it in a damped dynamic burst (`pftwin.dynamics.relaxation`), under guided bodies that
stand still, until it comes to rest; and the state counts one snap more. So inertia decides nothing: it lands where it
lands without swing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.equilibrium import REACH, RIDGE, downhill, tolerance_of
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.relaxation import come_to_rest
from pftwin.dynamics.solve import eliminate
from pftwin.dynamics.state import Guide, GuideAt, State, System, moved
from pftwin.dynamics.static_load import LEVER, Surroundings, components, look_around
from pftwin.effects.base import Instant
from pftwin.leaves import all_changes
from pftwin.spatial import Scalar, Twist, Vec3, Wrench

ORDER = 2
MOST_ITERATIONS = 20  # of Newton's iteration, for a neighbouring equilibrium
FARTHEST = 5e-3  # how far from where the motion would lead an equilibrium still counts as the same one [m]
NEUTRAL = 1e-6  # of the tangent's trace: a stiffness down to minus that counts as none, neutral and not unstable


class Carried(NamedTuple):
    """From step to step."""

    way: Twist  # d_last
    share: Scalar  # s of the next step
    snaps: Scalar  # since the start
    unsettled: Scalar  # what is left of the balance where it is not met [N]


class _Branch(NamedTuple):
    """Where a solution is looked for, and how rates come in."""

    system: System
    origin: State  # d counts from here
    guide: Guide  # at the step's end
    step: Scalar
    rates: Scalar  # 1 in motion, 0 where everything stands still

    def after(self, d: list[Scalar], past: Scalar | float = 1.0) -> State:
        """The state displaced by d, in metres and angles * lever, with the velocity that this means.

        Where `past` is 0, the last step's displacement counts for nothing.
        """
        way, share = Twist(Vec3(*d[:3]), (1 / LEVER) * Vec3(*d[3:])), past * self.origin.carried.share
        span = (1 - share) * self.step
        return moved(self.origin, way, way.plus(-share, self.origin.carried.way).times(self.rates / span))

    def instant(self, d: list[Scalar]) -> Instant:
        """What effects look at there."""
        return self.guide.slowed(self.rates).instant(self.after(d).patella(), self.step)

    def held_instant(self, d: list[Scalar], held: Scalar) -> Instant:
        """The same as an implicit step sees it; where `held` is 1, contacts that open hold on as linear springs."""
        patella = self.after(d, 1 - held).patella()
        twist = Twist(patella.velocity, patella.spin)
        guide = self.guide.slowed(self.rates)
        return guide.instant(patella, 0.0, held * self.step, reach=self.step, twist=twist)

    def recalling(self, looked: tuple[Any, ...]) -> _Branch:
        """The same with memories that a look has refined."""
        memories = self.system.refined(self.origin.memories, looked)
        return self._replace(origin=eqx.tree_at(lambda s: s.memories, self.origin, memories))

    def residual(self, d: list[Scalar]) -> list[Scalar]:
        """Force, and moment / lever, that nothing balances [N]."""
        loads, _ = self.system.loads(self.instant(d), self.origin.memories)
        return components(sum((load.total() for load in loads), start=Wrench.zero()))


def begin(system: System, state: State, guide: Guide, step: Scalar) -> State:
    """The state without a past; it goes on with the velocity that it has."""
    zero = jnp.zeros_like(state.position.x)
    carried = Carried(Twist(state.velocity, state.spin).times(step), zero, zero, zero)
    return eqx.tree_at(lambda s: s.carried, state, carried, is_leaf=lambda x: x is None)


def quasi_static(
    system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Ledger | None = None
) -> tuple[State, Ledger | None]:
    """The state one step later, and the energy ledger where one is kept."""
    branch = _Branch(system, state, guide_at(1.0), step, jnp.ones_like(step))
    found = _solved(branch)
    landed = found.landed(branch)
    after = landed.after(found.d)
    loads, memories = system.loads(landed.instant(found.d), landed.origin.memories)
    snapped = found.snapped > 0
    way = Twist(Vec3(*found.d[:3]), (1 / LEVER) * Vec3(*found.d[3:]))
    way = jax.tree.map(lambda a, b: jnp.where(snapped, a, b), _carried_along(branch, after), way)
    share = jnp.where(snapped, 0.0, jnp.full_like(step, 1 / 3))
    carried = Carried(way, share, state.carried.snaps + found.snapped, found.unsettled)
    after = eqx.tree_at(lambda s: (s.memories, s.carried), after, (memories, carried))
    if ledger is None:
        return after, None
    followed = ledger.entered(state, after, loads, None, 1.0, step, Twist(after.velocity, after.spin))
    return after, jax.tree.map(lambda a, b: jnp.where(snapped, a, b), _over_a_snap(ledger, branch, loads), followed)


def _carried_along(branch: _Branch, state: State) -> Twist:
    """The way of a patella that is at rest on the femur, in a step."""
    femur = branch.guide.femur
    if femur is None:
        return Twist(state.velocity, state.spin).times(0.0)
    turning = state.orientation.unrotate(femur.angular_velocity)
    return Twist(femur.velocity_at(state.position), turning).times(branch.step)


def _over_a_snap(ledger: Ledger, branch: _Branch, landed: list[Any]) -> Ledger:
    """The guided bodies move first, the patella then: what it stores less at its end has become heat."""
    held = branch._replace(rates=jnp.zeros_like(branch.rates))
    standing = held.after([jnp.zeros_like(branch.step)] * 6)
    loads, _ = branch.system.loads(branch.guide.instant(standing.patella(), 0.0), branch.origin.memories)
    entered = ledger.entered(standing, standing, loads, None, 1.0, branch.step)
    stored = [sum((x.energy for x in own if x.energy is not None), jnp.zeros(())) for own in (loads, landed)]
    return eqx.tree_at(lambda a: a.heat, entered, entered.heat + stored[0] - stored[1])


class _Found(NamedTuple):
    """A solution."""

    d: list[Scalar]  # from the state's pose, or after a snap from the place where the burst ended
    place: State  # where that was
    snapped: Scalar  # 1 after a snap
    unsettled: Scalar
    looked: tuple[Any, ...]  # memories of the last look

    def landed(self, branch: _Branch) -> _Branch:
        """The branch that it lies on."""
        origin = jax.tree.map(lambda a, b: jnp.where(self.snapped > 0, a, b), self.place, branch.origin)
        return branch._replace(origin=origin, rates=branch.rates - self.snapped).recalling(self.looked)


class _Iterate(NamedTuple):
    d: list[Scalar]
    size: Scalar  # of the residual [N]
    stable: Scalar
    count: Scalar
    done: Scalar
    looked: tuple[Any, ...]  # memories of the last look


def _norm(d: list[Scalar]) -> Scalar:
    return jnp.sqrt(sum((a * a for a in d[1:]), start=d[0] * d[0]))


def _improved(branch: _Branch, guess: list[Scalar], at: _Iterate, tolerance: float) -> _Iterate:
    """One Newton iteration; a displacement that meets the tolerance stays."""
    dtype = branch.step.dtype

    held = jnp.where(at.count == 0, branch.rates, 0.0)

    def instant(small: list[Scalar]) -> Instant:
        return branch.held_instant([a + b for a, b in zip(at.d, small, strict=True)], held)

    there = look_around(branch.system, instant, branch.origin.memories, dtype)
    size = _norm(there.residual())
    d = downhill(there, size / REACH)
    length = _norm(d)
    met = (size < tolerance) & (held == 0)
    lost = ~jnp.isfinite(length) | ~jnp.isfinite(size)
    scale = jnp.where(met | lost, 0.0, jnp.minimum(1.0, REACH / jnp.maximum(length, 1e-12)))
    d = [a + jnp.where(scale == 0, 0.0, scale * b) for a, b in zip(at.d, d, strict=True)]
    strayed = _norm([a - b for a, b in zip(d, guess, strict=True)]) > FARTHEST
    done = met | lost | (strayed & (branch.rates > 0))
    return _Iterate(d, size, _stable(branch, there), at.count + 1, done, there.memories)


def _stable(branch: _Branch, there: Surroundings) -> Scalar:
    """Whether the tangent at rest, dashpots left out, is positive definite."""
    span = (1 - branch.origin.carried.share) * branch.step
    k, c = there.tangent(), there.viscosity()
    rows = [[k[i, j] - (branch.rates / span) * c[i][j] for j in range(6)] for i in range(6)]
    slack = sum((rows[i][i] for i in range(1, 6)), start=rows[0][0]) * jnp.asarray(NEUTRAL, rows[0][0].dtype)
    middle = [[0.5 * (rows[i][j] + rows[j][i]) + (slack if i == j else 0.0) for j in range(6)] for i in range(6)]
    stable = jnp.isfinite(slack)
    for pivot in eliminate(middle, [slack] * 6)[1]:
        stable = stable & (pivot > 0)
    return stable


def _newton(branch: _Branch, guess: list[Scalar]) -> _Iterate:
    """The equilibrium near a guess, if there is one."""
    tolerance = tolerance_of(branch.step.dtype)
    infinite = jnp.full_like(branch.step, jnp.inf)
    no = jnp.array(False)
    start = _Iterate(guess, infinite, no, jnp.zeros((), int), no, branch.origin.memories)
    return jax.lax.while_loop(
        lambda at: ~at.done & (at.count < MOST_ITERATIONS),
        lambda at: _improved(branch, guess, at, tolerance),
        start,
    )


@eqx.filter_custom_jvp
def _solved(branch: _Branch) -> _Found:
    """The next equilibrium: the same one further on, or where a snap from the present pose comes to rest."""
    tolerance = tolerance_of(branch.step.dtype)
    last = branch.origin.carried.way
    ahead = [last.linear.x, last.linear.y, last.linear.z, *(LEVER * a for a in last.angular.array())]
    none = [jnp.zeros_like(a) for a in ahead]
    led = moved(branch.origin, last, last)

    def attempt(now: tuple[_Found, Scalar, Scalar]) -> tuple[_Found, Scalar, Scalar]:
        _, tries, _ = now
        snapped = jnp.where(tries > 0, 1.0, 0.0).astype(branch.step.dtype)
        place = jax.tree.map(lambda a, b: jnp.where(tries > 0, a, b), led, branch.origin)
        place = come_to_rest(branch.system, place, branch.guide.slowed(0.0), tries > 0)
        there = branch._replace(origin=place, rates=branch.rates - snapped)
        at = _newton(there, [jnp.where(tries > 0, b, a) for a, b in zip(ahead, none, strict=True)])
        settled = at.size < tolerance
        unsettled = jnp.where(settled, 0.0, at.size)
        again = ~(settled & at.stable) & (tries == 0)
        return _Found(at.d, place, snapped, unsettled, at.looked), tries + 1, again

    zero = jnp.zeros_like(branch.step)
    start = _Found(ahead, branch.origin, zero, zero, branch.origin.memories), jnp.zeros((), int), jnp.array(True)
    return jax.lax.while_loop(lambda now: now[2], attempt, start)[0]


@_solved.def_jvp
def _solved_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """With r(d, p) = 0: dd = -(dr/dd)^-1 (dr/dp) dp, on the branch where the solution lies."""
    (branch,) = primals
    found = _solved(branch)

    def residual(d: Array, branch: _Branch) -> Array:
        return jnp.stack(found.landed(branch).residual([d[i] for i in range(6)]))

    d = jnp.stack(found.d)
    moving, still = eqx.partition(branch, eqx.is_inexact_array)
    changes = all_changes(moving, tangents[0])
    right = jax.jvp(lambda m: residual(d, eqx.combine(m, still)), (moving,), (changes,))[1]
    tangent = jax.vmap(lambda e: jax.jvp(lambda x: residual(x, branch), (d,), (e,))[1])(jnp.eye(6, dtype=d.dtype))
    ridge = RIDGE * jnp.trace(tangent) * jnp.eye(6, dtype=d.dtype)  # a neutral direction does not change
    change = jnp.linalg.solve(-tangent.T - ridge, right)
    none = jax.tree.map(lambda a: jnp.zeros_like(a) if eqx.is_inexact_array(a) else None, found)
    return found, none._replace(d=[change[i] for i in range(6)])
