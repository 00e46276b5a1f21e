"""Static equilibrium of the patella on guided bodies that stand still.

Newton-Raphson with a trust region (Michaud et al. 2024, section 2.3.3 solve the same problem by Newton-Raphson): the
tangent of the whole static load, contacts included, is shifted by |r| / reach, which bounds a step by `reach` and
vanishes at the solution, so the last iterations converge quadratically. Where the tangent is indefinite (between two
equilibria) the stiff terms' own positive semidefinite part takes its place. Where that has led nowhere for a while, as
on a mesh of few triangles, across whose edges forces jump, the shift grows with every step for the worse and shrinks
with every one for the better. `relax` is the fallback.

The tangent is taken by central differences: as good as automatic differentiation here (relative error 1e-8 in float64)
and far quicker to compile.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.linear_implicit import linear_implicit
from pftwin.dynamics.solve import Lower, add_outer, factor, solve
from pftwin.dynamics.state import Guide, System
from pftwin.effects.base import Instant, Patella
from pftwin.effects.damping import LinearDamping
from pftwin.spatial import Pose, Quaternion, Scalar, Vec3, Wrench, safe_sqrt

REACH = 2e-3  # longest step [m]
LEVER = 0.02  # turns moments into forces and angles into lengths: about the patella's half width [m]
SEARCH_STEPS = 4  # loads at rest that make rough memories right
MOST_ITERATIONS = 200
PATIENCE = 50  # iterations after which steps that make it worse are followed by shorter ones
MOST_CAUTION = 1e4  # what their shift is multiplied by at most
RELAXATION_STEPS = 1500
RELAXATION_STEP = 2e-3  # [s]


class Solution(eqx.Module):
    """An equilibrium and how well it is met."""

    pose: Pose  # of the centre of mass, world
    memories: tuple[Any, ...]  # the effects', to start a motion with
    residual: Scalar  # norm of force and moment / lever [N]
    iterations: Scalar
    stiffness: Array  # (6, 6) tangent: force and moment / lever against displacement and angle * lever [N/m]

    def converged(self) -> Scalar:
        """Whether the residual is below what the float type can promise (1e-6 N in float64)."""
        return self.residual < tolerance_of(self.residual.dtype)


def tolerance_of(dtype: Any) -> float:
    """Largest residual of a converged equilibrium [N]; in float32 a contact's rounding alone is some millinewtons."""
    return 1e-6 if dtype == jnp.float64 else 2e-2


class _Iterate(NamedTuple):
    pose: Pose
    memories: tuple[Any, ...]
    residual: Scalar
    stiffness: Array
    count: Scalar
    done: Scalar
    caution: Scalar  # what the shift is multiplied by


def _still(guide: Guide, pose: Pose) -> Instant:
    """The patella at rest at a pose."""
    return guide.instant(Patella.at_rest(pose.position, pose.orientation), 0.0)


def _moved(pose: Pose, d: list[Scalar]) -> Pose:
    """The pose displaced by d: metres in the world, and rotation about the body's axes as angle * lever."""
    turn = Quaternion.from_rotation_vector((1 / LEVER) * Vec3(*d[3:]))
    return Pose(pose.position + Vec3(*d[:3]), (pose.orientation * turn).normalised())


def _components(w: Wrench) -> list[Scalar]:
    f, m = w.force, w.moment
    return [f.x, f.y, f.z, m.x / LEVER, m.y / LEVER, m.z / LEVER]


def _residual(system: System, guide: Guide, pose: Pose, memories: tuple[Any, ...]) -> list[Scalar]:
    loads, _ = system.loads(_still(guide, pose), memories)
    return _components(sum((load.total() for load in loads), start=Wrench.zero()))


class _Look(NamedTuple):
    """What one pose and its twelve neighbours tell."""

    memories: tuple[Any, ...]
    table: Array  # (13, 6) static loads
    convex: Lower  # the stiff terms' own stiffness, positive semidefinite


def _look(system: System, guide: Guide, pose: Pose, memories: tuple[Any, ...]) -> _Look:
    """Loads at a pose and at its twelve neighbours, all at once, so that effects are compiled once."""
    dtype = pose.position.x.dtype
    small = _difference(dtype)
    zero = jnp.zeros((), dtype)

    def evaluate(displacement: Array) -> tuple[Array, Any]:
        loads, later = system.loads(_still(guide, _moved(pose, [displacement[i] for i in range(6)])), memories)
        r = _components(sum((load.total() for load in loads), start=Wrench.zero()))
        own = [term for load in loads for term in load.stiff], [load.bed for load in loads if load.bed is not None]
        return jnp.stack(r), (later, own)

    steps = small * jnp.eye(6, dtype=dtype)
    here = jnp.zeros((1, 6), dtype)
    table, rest = jax.vmap(evaluate)(jnp.concatenate([here, steps, -steps]))
    later, (terms, beds) = jax.tree.map(lambda a: a[0], rest)
    convex: Lower = [[zero] * (i + 1) for i in range(6)]
    for term in terms:
        convex = add_outer(convex, _components(Wrench(term.direction, term.moment)), term.stiffness)
    for bed in beds:
        scale = jnp.asarray([1.0] * 3 + [1 / LEVER] * 3, dtype)
        own = scale[:, None] * bed.stiffness * scale[None, :]
        convex = [[a + own[i, j] for j, a in enumerate(row)] for i, row in enumerate(convex)]
    return _Look(later, table, convex)


def _difference(dtype: Any) -> float:
    """Step of the central differences [m]."""
    return 1e-9 if dtype == jnp.float64 else 2e-6


def _solved(matrix: Lower, shift: Scalar, r: list[Scalar]) -> tuple[list[Scalar], Scalar]:
    """The step of (matrix + shift I) d = r, and whether that matrix is positive definite."""
    shifted = [[a + shift if i == j else a for j, a in enumerate(row)] for i, row in enumerate(matrix)]
    low, inverse = factor(shifted)
    definite = jnp.array(True)
    for p in inverse:
        definite = definite & (p > 0) & jnp.isfinite(p)
    return solve(low, inverse, r), definite


def _size(r: list[Scalar]) -> Scalar:
    square = sum((a * a for a in r[1:]), start=r[0] * r[0])
    return jnp.where(jnp.isnan(square), square, safe_sqrt(square))  # a load that is not known is not none


def _improved(system: System, guide: Guide, at: _Iterate, tolerance: float) -> _Iterate:
    """One Newton iteration; a pose that meets the tolerance stays."""
    searching = at.count < SEARCH_STEPS  # the pose waits until the memories are right
    look = _look(system, guide, at.pose, at.memories)
    r = [look.table[0, i] for i in range(6)]
    size = _size(r)
    slopes = (look.table[7:] - look.table[1:7]) / (2 * _difference(size.dtype))
    stiffness = 0.5 * (slopes + slopes.T)
    tangent: Lower = [[stiffness[i, j] for j in range(i + 1)] for i in range(6)]
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), tangent, look.convex)  # compiled once for the two of them
    caution = _caution(at, size)
    steps, definite = jax.vmap(lambda matrix: _solved(matrix, caution * size / REACH, r))(both)
    d = [jnp.where(definite[0], a[0], a[1]) for a in steps]
    length = _size(d)
    shorter = jnp.minimum(1.0, 2 * REACH / jnp.maximum(length, 1e-12))
    floor = (size < tolerance) & (size > 0.5 * at.residual)  # rounding: Newton's iteration has no more to give
    done = ((size < 0.01 * tolerance) | floor) & ~searching
    scale = jnp.where(done | searching | ~jnp.isfinite(length), 0.0, shorter)
    d = [jnp.where(scale == 0, 0.0, scale * a) for a in d]
    return _Iterate(_moved(at.pose, d), look.memories, size, stiffness, at.count + 1, done, caution)


def _caution(at: _Iterate, size: Scalar) -> Scalar:
    """Shorter steps where long ones have led nowhere; 1 until then."""
    changed = jnp.clip(at.caution * jnp.where(size > at.residual, 4.0, 0.5), 1.0, MOST_CAUTION)
    return jnp.where(at.count < PATIENCE, 1.0, changed)


@eqx.filter_custom_jvp
def solve_equilibrium(system: System, guide: Guide, guess: Pose) -> Solution:
    """The equilibrium nearest to a guess, downhill. Jit and vmap apply; derivatives by the implicit function theorem.

    The iteration goes on to a hundredth of the tolerance, or below the tolerance until it gets no better, or until its
    count runs out. One variant that went on to the end would hold up its whole batch.
    """
    zero = jnp.zeros_like(guess.position.x)
    tolerance = tolerance_of(zero.dtype)
    start = _Iterate(
        guess,
        system.guess(_still(guide, guess)),
        zero + jnp.inf,
        jnp.zeros((6, 6), zero.dtype),
        jnp.zeros((), int),
        jnp.array(False),
        zero + 1.0,
    )
    found = jax.lax.while_loop(
        lambda at: ~at.done & (at.count < MOST_ITERATIONS),
        lambda at: _improved(system, guide, at, tolerance),
        start,
    )
    return Solution(found.pose, found.memories, found.residual, found.count, found.stiffness)


@solve_equilibrium.def_jvp
def _solve_equilibrium_jvp(primals: Any, tangents: Any) -> tuple[Solution, Solution]:
    """With r(q, p) = 0: dq = K^-1 (dr/dp) dp. Memory, residual and count have no derivative."""
    system, guide, guess = primals
    solution = solve_equilibrium(system, guide, guess)

    def slope(factor: Scalar) -> Array:
        def residual(a: System, b: Guide) -> Array:
            return jnp.stack(_residual(a, b, solution.pose, solution.memories))

        scaled = jax.tree.map(lambda a: factor * a, tuple(tangents[:2]))
        return eqx.filter_jvp(residual, (system, guide), scaled)[1]

    # In a loop and by the library's solver: what is stored is not computed again for every use of its entries.
    dr = jax.lax.map(slope, jnp.array([1.0, 0.0], solution.residual.dtype))[0]
    d = list(jnp.linalg.solve(solution.stiffness, dr))
    zeros = [jnp.zeros_like(a) for a in d]
    _, moved = jax.jvp(lambda *step: _moved(solution.pose, list(step)), zeros, d)
    still = jax.tree.map(lambda a: None if not eqx.is_inexact_array(a) else jnp.zeros_like(a), solution)
    return solution, eqx.tree_at(lambda s: s.pose, still, moved)


def relax(system: System, guide: Guide, pose: Pose) -> Pose:
    """Where heavily damped dynamics comes to rest: the fallback when Newton's iteration does not end."""
    rate = 20.0  # [1/s]: overdamped against the tendons' slow modes, settled well within the time given
    i = system.inertia
    damping = LinearDamping(rate * system.mass, rate * jnp.maximum(jnp.maximum(i.x, i.y), i.z), body="ground")
    damped = eqx.tree_at(lambda s: s.effects, system, (*system.effects, damping))
    state = damped.start(pose, guide)
    step = jnp.asarray(RELAXATION_STEP, dtype=pose.position.x.dtype)
    state = jax.lax.fori_loop(0, RELAXATION_STEPS, lambda _, s: linear_implicit(damped, s, guide, step)[0], state)
    return Pose(state.position, state.orientation)
