"""Static equilibrium of the patella on guided bodies that stand still.

Newton-Raphson (Michaud et al. 2024, section 2.3.3) with a trust region: see docs/physics.md. If the search stalls,
as on a coarse mesh whose forces jump across edges, the shift grows with every step that increases the residual and
shrinks with every step that lowers it. `pftwin.dynamics.relaxation` is the fallback. The tangent is taken by central
differences: as good as automatic differentiation here (relative error 1e-8 in float64) and much quicker to compile.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.spatial import Pose, Scalar, safe_sqrt
from pftwin.dynamics.solve import eliminate
from pftwin.dynamics.state import Guide, System
from pftwin.dynamics.static_load import Surroundings, displaced_pose, look_around, patella_at_rest, residual

REACH = 2e-3  # longest step [m]
SEARCH_STEPS = 4  # evaluations that turn rough memories into exact ones before the pose moves
MOST_ITERATIONS = 200
PATIENCE = 50  # iterations after which a step that increases the residual makes the next steps shorter
ROUNDINGS = 12  # roundings in a stretch: see `_rounding`
RIDGE = 1e-12  # share of the tangent's trace that is added: a direction without stiffness gets derivative zero, not NaN
MOST_CAUTION = 1e4  # largest factor on the shift


class Solution(eqx.Module):
    """An equilibrium and how well it is met."""

    pose: Pose  # of the centre of mass, world
    memories: tuple[Any, ...]  # the effects', to start a motion with
    residual: Scalar  # norm of force and moment / lever [N]
    iterations: Scalar
    stiffness: Array  # (6, 6) tangent: what force and moment / lever lose per displacement and angle * lever [N/m]
    rounding: Scalar | float = 0.0  # what the float type's rounding of places makes of the load, see `_rounding` [N]

    def tolerance(self) -> Scalar:
        """Largest residual of a converged equilibrium: what the float type can promise [N]."""
        return jnp.maximum(jnp.asarray(tolerance_of(self.residual.dtype), self.residual.dtype), self.rounding)

    def converged(self) -> Scalar:
        """Whether the residual is below the tolerance (1e-6 N in float64 but for extreme stiffness)."""
        return self.residual < self.tolerance()


def tolerance_of(dtype: Any) -> float:
    """Largest residual of a converged equilibrium whose contacts and tendons are not stiffer than usual [N]."""
    return 1e-6 if dtype == jnp.float64 else 2e-2


def tolerance_on_host(solution: Solution) -> NDArray[np.floating]:
    """`Solution.tolerance` without a program, of one or a batch [N]."""
    return np.maximum(tolerance_of(solution.residual.dtype), np.asarray(solution.rounding))


def converged_on_host(solution: Solution) -> NDArray[np.bool_]:
    """`Solution.converged` without a program, of one or a batch."""
    return np.asarray(solution.residual) < tolerance_on_host(solution)


def place_unknown(solution: Solution) -> float:
    """How far from the true equilibrium the patella may rest because of the float type's rounding [m]; on the host.

    What is left of the load, and what of it rounding hides, over the stiffness of the softest direction. 0 where the
    load is known to the usual tolerance, as it always is in float64 but for extreme stiffness.
    """
    rounding = float(solution.rounding)
    if rounding <= tolerance_of(solution.residual.dtype):
        return 0.0
    stiffness = np.asarray(solution.stiffness, np.float64)
    softest = np.linalg.svd(stiffness, compute_uv=False)[-1] if np.isfinite(stiffness).all() else 0.0
    return (float(solution.residual) + rounding) / softest if softest > 0 else np.inf


def _rounding(system: System, pose: Pose, there: Surroundings) -> Scalar:
    """Uncertainty of the load due to the rounding of positions [N].

    A stiff term's stretch comes from coordinates of the size L of the patella's place and of the arm to its button's
    middle, by six independent roundings of eps / 2 * L: the place as it is stored, the arm's rotation (two), the sum of
    both, the surface's point, the distance to it. A residual has them twice: where the last step was found, and where
    it leads. With a force k s along g = (direction, moment / lever) it is off by k |g| sqrt(`ROUNDINGS`) eps / 2 * L;
    the sum of all k |g| is at most the root of that of k times that of k |g|^2.
    """
    arms = [c.tracked_point().norm() for e in system.effects if (c := e.contact_role()) is not None]
    size = pose.position.norm() + (jnp.max(jnp.stack(arms)) if arms else 0.0)
    rows = there.convex()
    force, moment = (rows[i][i] + rows[i + 1][i + 1] + rows[i + 2][i + 2] for i in (0, 3))
    return (0.5 * ROUNDINGS**0.5 * float(jnp.finfo(size.dtype).eps)) * size * safe_sqrt(force * (force + moment))


class _Iterate(NamedTuple):
    pose: Pose
    memories: tuple[Any, ...]
    residual: Scalar
    stiffness: Array
    rounding: Scalar
    count: Scalar
    done: Scalar
    caution: Scalar  # factor on the shift

    def solution(self) -> Solution:
        """The solution with strong dtypes, so that before and after the search it has the same structure."""
        whole = Solution(self.pose, self.memories, self.residual, self.count, self.stiffness, self.rounding)
        return jax.tree.map(lambda a: jax.lax.convert_element_type(a, a.dtype), whole)


def step_of(matrix: list[list[Scalar]], r: list[Scalar]) -> tuple[list[Scalar], Scalar]:
    """The step d [m] of matrix d = r [N], and whether its pivots are positive: then it goes downhill."""
    d, inverse = eliminate(matrix, r)
    definite = jnp.array(True)
    for p in inverse:
        definite = definite & (p > 0) & jnp.isfinite(p)
    return d, definite


def entries(matrix: Array) -> list[list[Scalar]]:
    """Those of a (6, 6) matrix, row by row."""
    return [[matrix[i, j] for j in range(6)] for i in range(6)]


def downhill(there: Surroundings, shift: Scalar) -> list[Scalar]:
    """Newton's step with the tangent plus a multiple of the identity, where that leads downhill.

    Elsewhere the stiff terms' own positive semidefinite part takes the tangent's place.
    """
    r, tangent = there.residual(), entries(there.tangent())

    def shifted_step(matrix: list[list[Scalar]]) -> tuple[list[Scalar], Scalar]:
        return step_of([[a + shift if i == j else a for j, a in enumerate(row)] for i, row in enumerate(matrix)], r)

    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), tangent, there.convex())  # compiled once for both
    steps, definite = jax.vmap(shifted_step)(both)
    return [jnp.where(definite[0], a[0], a[1]) for a in steps]


def _size(r: list[Scalar]) -> Scalar:
    square = sum((a * a for a in r[1:]), start=r[0] * r[0])
    return jnp.where(jnp.isnan(square), square, safe_sqrt(square))  # an unknown load must not count as zero


def _improved(system: System, guide: Guide, at: _Iterate) -> _Iterate:
    """One Newton iteration; a pose that meets the tolerance stays."""
    searching = at.count < SEARCH_STEPS  # the pose waits until the memories are right
    there = look_around(system, lambda d: patella_at_rest(guide, displaced_pose(at.pose, d)), at.memories, at.residual)
    r, stiffness = there.residual(), there.tangent()
    size = _size(r)
    changed = jnp.clip(at.caution * jnp.where(size > at.residual, 4.0, 0.5), 1.0, MOST_CAUTION)
    caution = jnp.where(at.count < PATIENCE, 1.0, changed)  # above 1 where the search has stalled
    d = downhill(there, caution * size / REACH)
    length = _size(d)
    shorter = jnp.minimum(1.0, 2 * REACH / jnp.maximum(length, 1e-12))
    rounding = _rounding(system, at.pose, there)
    tolerance = jnp.maximum(jnp.asarray(tolerance_of(size.dtype), size.dtype), rounding)
    floor = (size < tolerance) & (size > 0.5 * at.residual)  # rounding: Newton's iteration has no more to give
    done = ((size < 0.01 * tolerance) | floor) & ~searching
    scale = jnp.where(done | searching | ~jnp.isfinite(length), 0.0, shorter)
    d = [jnp.where(scale == 0, 0.0, scale * a) for a in d]
    return _Iterate(displaced_pose(at.pose, d), there.memories, size, stiffness, rounding, at.count + 1, done, caution)


def _start(system: System, guide: Guide, guess: Pose) -> _Iterate:
    x = guess.position.x
    zero = jnp.where(x > 0, jnp.zeros_like(x), 0)  # batched where the guess is: `vmap` need not trace again to find out
    memories = system.guess(patella_at_rest(guide, guess))
    stiffness = jnp.broadcast_to(zero, (6, 6))
    return _Iterate(guess, memories, zero + jnp.inf, stiffness, zero, zero.astype(int), zero > 0, zero + 1.0)


def initial_solution(system: System, guide: Guide, guess: Pose) -> Solution:
    """A solution before the search: of the same structure, so that what goes on from one can be compiled ahead."""
    return _start(system, guide, guess).solution()


@eqx.filter_custom_jvp
def solve_equilibrium(system: System, guide: Guide, guess: Pose) -> Solution:
    """The equilibrium nearest to a guess, downhill. Jit and vmap apply; derivatives by the implicit function theorem.

    The iteration ends at a hundredth of the tolerance, or below the tolerance once it stops improving (else one member
    that keeps iterating would hold up its whole batch), or at `MOST_ITERATIONS`. Members whose contacts are found
    in turns take turns here too: none waits for the slowest.
    """
    if not any(e.in_turns for e in system.effects):
        return _searched(system, guide, guess)
    from pftwin.geometry.bvh.loops import member_by_member  # a scene without meshes imports nothing of theirs

    return member_by_member(_searched)(system, guide, guess)


def _searched(system: System, guide: Guide, guess: Pose) -> Solution:
    found = jax.lax.while_loop(
        lambda at: ~at.done & (at.count < MOST_ITERATIONS),
        lambda at: _improved(system, guide, at),
        _start(system, guide, guess),
    )
    return found.solution()


@solve_equilibrium.def_jvp
def _solve_equilibrium_jvp(primals: Any, tangents: Any) -> tuple[Solution, Solution]:
    """With r(q, p) = 0: dq = K^-1 (dr/dp) dp. Memory, residual and count have no derivative."""
    system, guide, guess = primals
    solution = solve_equilibrium(system, guide, guess)

    def slope(factor: Scalar) -> Array:
        def load(a: System, b: Guide) -> Array:
            return jnp.stack(residual(a, b, solution.pose, solution.memories))

        scaled = jax.tree.map(lambda a: factor * a, tuple(tangents[:2]))
        return eqx.filter_jvp(load, (system, guide), scaled)[1]

    # In a loop, and by LAPACK: XLA does not recompute stored results at every use of their entries.
    dr = jax.lax.map(slope, jnp.array([1.0, 0.0], solution.residual.dtype))[0]
    ridge = RIDGE * jnp.trace(solution.stiffness) * jnp.eye(6, dtype=dr.dtype)
    d = list(jnp.linalg.solve(solution.stiffness + ridge, dr))
    zeros = [jnp.zeros_like(a) for a in d]
    _, change = jax.jvp(lambda *step: displaced_pose(solution.pose, list(step)), zeros, d)
    none = jax.tree.map(lambda a: None if not eqx.is_inexact_array(a) else jnp.zeros_like(a), solution)
    return solution, eqx.tree_at(lambda s: s.pose, none, change)
