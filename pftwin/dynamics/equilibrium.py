"""Static equilibrium of the patella on guided bodies that stand still.

Newton-Raphson with a trust region (Michaud et al. 2024, section 2.3.3 solve the same problem by Newton-Raphson): the
tangent of the whole static load, contacts included, is shifted by |r| / reach, which bounds a step by `reach` and
vanishes at the solution, so the last iterations converge quadratically. Where the tangent is indefinite (between two
equilibria) the stiff terms' own positive semidefinite part takes its place. `relax` is the fallback.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.linear_implicit import linear_implicit
from pftwin.dynamics.solve import factor, solve
from pftwin.dynamics.state import Guide, System
from pftwin.effects.base import Instant, Patella, StiffTerm
from pftwin.effects.damping import LinearDamping
from pftwin.spatial import Pose, Quaternion, Scalar, Vec3, Wrench

REACH = 2e-3  # longest step [m]
LEVER = 0.02  # turns moments into forces and angles into lengths: about the patella's half width [m]
MOST_ITERATIONS = 80
RELAXATION_STEPS = 1500
RELAXATION_STEP = 2e-3  # [s]


class Solution(NamedTuple):
    """An equilibrium and how well it is met."""

    pose: Pose  # of the centre of mass, world
    residual: Scalar  # norm of force and moment / lever [N]
    iterations: Scalar
    stiffness: Array  # (6, 6) tangent: force and moment / lever against displacement and angle * lever [N/m]

    def converged(self, tolerance: float = 1e-6) -> Scalar:
        """Whether the residual is below a tolerance [N]."""
        return self.residual < tolerance


class _Iterate(NamedTuple):
    pose: Pose
    residual: Scalar
    stiffness: Array  # (6, 6)
    count: Scalar
    done: Scalar


def _moved(pose: Pose, d: Array) -> Pose:
    """The pose displaced by d: metres in the world, and rotation about the body's axes as angle * lever."""
    turn = Quaternion.from_rotation_vector(Vec3(d[3] / LEVER, d[4] / LEVER, d[5] / LEVER))
    return Pose(pose.position + Vec3(d[0], d[1], d[2]), (pose.orientation * turn).normalised())


def _vector(w: Wrench) -> Array:
    f, m = w.force, w.moment
    return jnp.stack([f.x, f.y, f.z, m.x / LEVER, m.y / LEVER, m.z / LEVER])


def _look(system: System, guide: Guide, pose: Pose) -> tuple[Array, Array, Array]:
    """Residual (6,), tangent stiffness (6, 6) and its positive semidefinite substitute at a pose.

    The tangent is taken by central differences over 13 poses: as good as automatic differentiation here
    (relative error 1e-8 in float64) and five times faster to compile.
    """
    memories = jax.lax.stop_gradient(system.remember(_still(guide, pose)))
    small = 1e-9 if pose.position.x.dtype == jnp.float64 else 2e-6
    unit = small * jnp.eye(6, dtype=pose.position.x.dtype)

    def load(d: Array) -> tuple[Wrench, list[StiffTerm]]:
        loads, _ = system.loads(_still(guide, _moved(pose, d)), memories)
        terms = [term for load in loads for term in load.stiff]
        return sum((load.total() for load in loads), start=Wrench.zero()), terms

    # A loop, not a batch: what leaves a loop is stored, and the compiler need not repeat the loads for every entry.
    wrenches, terms = jax.lax.map(load, jnp.concatenate([jnp.zeros((1, 6), unit.dtype), unit, -unit]))
    r = _vector(wrenches).T
    tangent = (r[1:7] - r[7:]) / (-2 * small)
    here = jax.tree.map(lambda a: a[0], terms)
    rows = [jnp.atleast_2d(_rows(term)) for term in here] or [jnp.zeros((1, 6), unit.dtype)]
    stiff = jnp.concatenate(rows)
    return r[0], 0.5 * (tangent + tangent.T), stiff.T @ stiff


def _still(guide: Guide, pose: Pose) -> Instant:
    """The patella at rest at a pose, seen without looking ahead."""
    return guide.instant(Patella.at_rest(pose.position, pose.orientation), 0.0)


def _rows(term: StiffTerm) -> Array:
    """sqrt(k) g for every direction of a stiff term, of shape (6,) or (n, 6)."""
    root = jnp.sqrt(jnp.maximum(term.stiffness, 0.0))
    d, m = term.direction, term.moment
    columns = [d.x, d.y, d.z, m.x / LEVER, m.y / LEVER, m.z / LEVER]
    return jnp.stack([root * jnp.broadcast_to(c, root.shape) for c in columns], axis=-1)


def _solve_shifted(matrix: Array, shift: Scalar, r: Array) -> tuple[Array, Scalar]:
    """The step of (matrix + shift I) d = r, and whether that matrix is positive definite."""
    lower = [[matrix[i, j] + (shift if i == j else 0.0) for j in range(i + 1)] for i in range(6)]
    low, inverse = factor(lower)
    definite = jnp.all(jnp.stack([(p > 0) & jnp.isfinite(p) for p in inverse]))
    return jnp.stack(solve(low, inverse, [r[i] for i in range(6)])), definite


def _improved(system: System, guide: Guide, at: _Iterate, tolerance: float) -> _Iterate:
    """One Newton iteration; a pose that meets the tolerance stays."""
    r, stiffness, safe_stiffness = _look(system, guide, at.pose)
    size = jnp.linalg.norm(r)
    exact, definite = _solve_shifted(stiffness, size / REACH, r)
    safe, _ = _solve_shifted(safe_stiffness, size / REACH, r)
    d = jnp.where(definite, exact, safe)
    d = d * jnp.minimum(1.0, 2 * REACH / jnp.maximum(jnp.linalg.norm(d), 1e-12))
    done = size < 0.01 * tolerance
    d = jnp.where(done | ~jnp.all(jnp.isfinite(d)), 0.0, d)
    return _Iterate(_moved(at.pose, d), size, stiffness, at.count + 1, done)


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


def solve_equilibrium(system: System, guide: Guide, guess: Pose, tolerance: float = 1e-6) -> Solution:
    """The equilibrium nearest to a guess, downhill. Jit-able, vmap-able; differentiable by the implicit function theorem.

    `tolerance` bounds the residual [N]; the iteration goes on to a hundredth of it, or until its count runs out.
    """
    fixed = jax.lax.stop_gradient((system, guide, guess))
    zero = jnp.zeros_like(guess.position.x)
    start = _Iterate(fixed[2], zero + jnp.inf, jnp.zeros((6, 6), zero.dtype), jnp.zeros((), int), jnp.array(False))
    found = jax.lax.while_loop(
        lambda at: ~at.done & (at.count < MOST_ITERATIONS),
        lambda at: _improved(fixed[0], fixed[1], at, tolerance),
        start,
    )
    pose = _differentiable(system, guide, found)
    return Solution(pose, found.residual, found.count, found.stiffness)


def _differentiable(system: System, guide: Guide, found: _Iterate) -> Pose:
    """One Newton step whose value is negligible and whose derivative is the implicit function theorem's."""
    pose = jax.lax.stop_gradient(found.pose)
    still = _still(guide, pose)
    loads, _ = system.loads(still, jax.lax.stop_gradient(system.remember(still)))
    r = _vector(sum((load.total() for load in loads), start=Wrench.zero()))
    shift = 1e-9 * jnp.trace(found.stiffness)
    tangent = jax.lax.stop_gradient(found.stiffness)
    d, _ = _solve_shifted(tangent, jax.lax.stop_gradient(shift), r - jax.lax.stop_gradient(r))
    return _moved(pose, d)

