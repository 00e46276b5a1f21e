"""Static equilibrium of the patella, with guided bodies at rest.

Newton-Raphson (Michaud et al. 2024, section 2.3.3) with a trust region: see docs/physics.md. If the search stalls,
e.g. on a coarse mesh whose forces jump across edges, the shift grows with every step that increases the residual, and
shrinks with every step that reduces it. A jump of the load within `AT_JUMP` of the pose is an equilibrium; the residual
there counts as uncertainty of the load. `pftwin.dynamics.relaxation` is the fallback. The tangent is from central
differences: as good as automatic differentiation here (relative error 1e-8 in float64), and much faster to compile.
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

LONGEST_STEP = 2e-3  # longest step [m]
SEARCH_STEPS = 4  # evaluations that refine the rough initial memories before the pose moves
MOST_ITERATIONS = 200
PATIENCE = 50  # iterations after which a step that increases the residual makes the next steps shorter
ROUNDINGS = 12  # number of roundings in a stretch: see `_rounding`
RIDGE = 1e-12  # fraction of the trace added to the tangent: gives directions without stiffness derivative 0, not NaN
MOST_CAUTION = 1e4  # largest factor on the shift
AT_JUMP = 1e-7  # longest Newton step between the two sides of a jump of the load [m]


class Solution(eqx.Module):
    """Result of the search for an equilibrium."""

    pose: Pose  # of the centre of mass, world
    memories: tuple[Any, ...]  # of the effects, to start a motion with
    residual: Scalar  # norm of force and moment / lever [N]
    iterations: Scalar
    stiffness: Array  # (6, 6) tangent: decrease of force and moment / lever per displacement and angle * lever [N/m]
    rounding: Scalar | float = 0.0  # uncertainty of the load [N]: rounding of positions, or a jump of the load

    def tolerance(self) -> Scalar:
        """Largest residual of a converged equilibrium, given the float type and jumps of the load [N]."""
        return jnp.maximum(jnp.asarray(tolerance_of(self.residual.dtype), self.residual.dtype), self.rounding)

    def converged(self) -> Scalar:
        """Whether the residual is below the tolerance (1e-6 N in float64 except for extreme stiffness or a jump)."""
        return self.residual < self.tolerance()


def tolerance_of(dtype: Any) -> float:
    """Largest residual of a converged equilibrium with contacts and tendons of usual stiffness [N]."""
    return 1e-6 if dtype == jnp.float64 else 2e-2


def tolerance_on_host(solution: Solution) -> NDArray[np.floating]:
    """`Solution.tolerance` on the host, of one solution or a batch [N]."""
    return np.maximum(tolerance_of(solution.residual.dtype), np.asarray(solution.rounding))


def converged_on_host(solution: Solution) -> NDArray[np.bool_]:
    """`Solution.converged` on the host, of one solution or a batch."""
    return np.asarray(solution.residual) < tolerance_on_host(solution)


def place_unknown(solution: Solution) -> float:
    """Possible distance of the patella from the true equilibrium due to rounding or a jump [m]; on the host.

    It is the residual plus the rounding error of the load, divided by the stiffness of the softest direction; 0 if the
    load is accurate to the usual tolerance, as in float64 except for extreme stiffness and at jumps.
    """
    rounding = float(solution.rounding)
    if rounding <= tolerance_of(solution.residual.dtype):
        return 0.0
    stiffness = np.asarray(solution.stiffness, np.float64)
    softest = np.linalg.svd(stiffness, compute_uv=False)[-1] if np.isfinite(stiffness).all() else 0.0
    return (float(solution.residual) + rounding) / softest if softest > 0 else np.inf


def _rounding(system: System, pose: Pose, there: Surroundings) -> Scalar:
    """Uncertainty of the load due to the rounding of positions [N].

    The stretch of a stiff term results from coordinates of size L (position of the patella plus its arm to the button's
    centre) with six independent roundings of eps / 2 * L: the stored position, the rotation of the arm (two), their
    sum, the point of the surface, and the distance to it. A residual contains them twice: at the pose where the last
    step was computed, and at its end. For a force k s along g = (direction, moment / lever), its error is
    k |g| sqrt(`ROUNDINGS`) eps / 2 * L; the sum of all k |g| is at most sqrt((sum of k) (sum of k |g|^2)).
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
        """The solution with strong dtypes, so that it has the same structure before and after the search."""
        whole = Solution(self.pose, self.memories, self.residual, self.count, self.stiffness, self.rounding)
        return jax.tree.map(lambda a: jax.lax.convert_element_type(a, a.dtype), whole)


def step_of(matrix: list[list[Scalar]], r: list[Scalar]) -> tuple[list[Scalar], Scalar]:
    """The step d [m] from matrix d = r [N], and whether all pivots are positive: then it is a descent direction."""
    d, inverse = eliminate(matrix, r)
    definite = jnp.array(True)
    for p in inverse:
        definite = definite & (p > 0) & jnp.isfinite(p)
    return d, definite


def entries(matrix: Array) -> list[list[Scalar]]:
    """Entries of a (6, 6) matrix, row by row."""
    return [[matrix[i, j] for j in range(6)] for i in range(6)]


def downhill(there: Surroundings, shift: Scalar) -> tuple[list[Scalar], Scalar]:
    """Newton's step with the tangent plus `shift` times the identity; and whether that is a descent direction.

    Otherwise the positive semidefinite stiffness of the stiff terms replaces the tangent.
    """
    r, tangent = there.residual(), entries(there.tangent())

    def shifted_step(matrix: list[list[Scalar]]) -> tuple[list[Scalar], Scalar]:
        return step_of([[a + shift if i == j else a for j, a in enumerate(row)] for i, row in enumerate(matrix)], r)

    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), tangent, there.convex())  # compiled once for both
    steps, definite = jax.vmap(shifted_step)(both)
    return [jnp.where(definite[0], a[0], a[1]) for a in steps], definite[0]


def _size(r: list[Scalar]) -> Scalar:
    square = sum((a * a for a in r[1:]), start=r[0] * r[0])
    return jnp.where(jnp.isnan(square), square, safe_sqrt(square))  # an unknown load must not count as zero


def _improved(system: System, guide: Guide, at: _Iterate) -> _Iterate:
    """One Newton iteration; a converged pose does not change."""
    remembers = bool(jax.tree.leaves(at.memories))
    refining = SEARCH_STEPS if remembers else 0  # the pose does not move until memories are refined
    searching, moved = at.count < refining, at.count > refining  # only then do two residuals belong to different poses
    there = look_around(system, lambda d: patella_at_rest(guide, displaced_pose(at.pose, d)), at.memories, at.residual)
    r, stiffness = there.residual(), there.tangent()
    size = _size(r)
    changed = jnp.clip(at.caution * jnp.where(size > at.residual, 4.0, 0.5), 1.0, MOST_CAUTION)
    caution = jnp.where(at.count < PATIENCE, 1.0, changed)  # above 1 where the search has stalled
    d, definite = downhill(there, caution * size / LONGEST_STEP)
    length = _size(d)
    shorter = jnp.minimum(1.0, 2 * LONGEST_STEP / jnp.maximum(length, 1e-12))
    rounding = _rounding(system, at.pose, there)
    tolerance = jnp.maximum(jnp.asarray(tolerance_of(size.dtype), size.dtype), rounding)
    floor = (size < tolerance) & (size > 0.5 * at.residual) & moved  # rounding prevents further improvement
    # The load jumps here, as where a triangle passes the rim of a mesh, and Newton's steps go to and fro across it.
    jump = (size >= at.residual) & (length < AT_JUMP) & definite & (caution <= 1) & moved
    rounding = jnp.where(jump, jnp.maximum(rounding, 2 * size), rounding)
    done = ((size < 0.01 * tolerance) & ~searching) | floor | jump
    scale = jnp.where(done | searching | ~jnp.isfinite(length), 0.0, shorter)
    d = [jnp.where(scale == 0, 0.0, scale * a) for a in d]
    return _Iterate(displaced_pose(at.pose, d), there.memories, size, stiffness, rounding, at.count + 1, done, caution)


def _start(system: System, guide: Guide, guess: Pose) -> _Iterate:
    x = guess.position.x
    zero = jnp.where(x > 0, jnp.zeros_like(x), 0)  # batched if the guess is, which saves `vmap` from tracing again
    memories = system.guess(patella_at_rest(guide, guess))
    stiffness = jnp.broadcast_to(zero, (6, 6))
    return _Iterate(guess, memories, zero + jnp.inf, stiffness, zero, zero.astype(int), zero > 0, zero + 1.0)


def initial_solution(system: System, guide: Guide, guess: Pose) -> Solution:
    """A solution before the search, with the final structure, so that programs that use it can be compiled ahead."""
    return _start(system, guide, guess).solution()


@eqx.filter_custom_jvp
def solve_equilibrium(system: System, guide: Guide, guess: Pose) -> Solution:
    """Solves for the equilibrium by descent from a guess, the pose of the centre of mass in the world.

    Supports jit, vmap, and differentiation by the implicit function theorem. The iteration ends at a hundredth of the
    tolerance, or below the tolerance once it stops improving (so that one variant does not delay its batch), or at
    `MOST_ITERATIONS`. Variants with an effect that is `in_turns` are solved one at a time: none waits for the slowest.
    """
    if not any(e.in_turns for e in system.effects):
        return _searched(system, guide, guess)
    from pftwin.geometry.bvh.loops import member_by_member  # imported only for scenes with meshes

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

    # A loop, and LAPACK, store their results, which XLA would otherwise recompute at every use of their entries.
    dr = jax.lax.map(slope, jnp.array([1.0, 0.0], solution.residual.dtype))[0]
    ridge = RIDGE * jnp.trace(solution.stiffness) * jnp.eye(6, dtype=dr.dtype)
    d = list(jnp.linalg.solve(solution.stiffness + ridge, dr))
    zeros = [jnp.zeros_like(a) for a in d]
    _, change = jax.jvp(lambda *step: displaced_pose(solution.pose, list(step)), zeros, d)
    none = jax.tree.map(lambda a: None if not eqx.is_inexact_array(a) else jnp.zeros_like(a), solution)
    return solution, eqx.tree_at(lambda s: s.pose, none, change)
