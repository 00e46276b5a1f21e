"""The equilibrium near a guess, by a cheap iteration first and by Newton's with the exact tangent where that fails.

The cheap iteration evaluates one pose per iterate. Its tangent is the stiff terms' own stiffness at that pose plus a
remainder, the rest of the last exact tangent, which changes little from step to step. Once the balance is nearly
met, one evaluation of the pose and its twelve neighbours gives the exact tangent: it tells whether the equilibrium is
stable, removes the rest of the residual, and provides the remainder for the next step. Where the residual is not halved
in every iteration, Newton's iteration starts again from the guess with the exact tangent at every iterate.

Stable is an equilibrium where a disturbance dies out in a viscous medium without inertia, d' = -K d / c: where every
eigenvalue of K has a positive real part. Where forces have a potential that is the same as definite. Those of meshes'
contours have none: the symmetric part of their K is often indefinite, and says nothing of a fold.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar
from pftwin.dynamics.equilibrium import REACH, entries, step_of, tolerance_of
from pftwin.dynamics.quasi_static.branch import Branch, norm
from pftwin.dynamics.solve import Six, inverse_with_pivots
from pftwin.dynamics.static_load import Surroundings

MOST_ITERATIONS = 20  # iterations with the exact tangent
MOST_SINGLE = 8  # iterations that evaluate one pose
SLOW = 0.5  # share of the residual that such an iteration may leave; beyond it the cheap iteration is abandoned
FARTHEST = 5e-3  # an equilibrium farther than this from the predicted pose counts as another one [m]
NEAR = 1e-5  # residual below which one more step with the remainder suffices before the exact evaluation [N]
POLISH = 1e-6  # longest last step that is taken without another evaluation [m]
NEUTRAL = 1e-6  # of the tangent's trace: a stiffness down to minus that counts as none, neutral and not unstable
SQUARINGS = 16  # from a factor that is 0.2 % off 1, as the slack's and the trace's own are, to one of 1e-57


class Iterate(NamedTuple):
    """A displacement and what was seen there."""

    d: Six
    size: Scalar  # of the residual before the last step [N]
    settled: Scalar  # whether that is below the tolerance
    stable: Scalar
    remainder: Array  # (6, 6) of the tangent [N/m]
    count: Scalar
    done: Scalar
    trial: tuple[Any, ...]  # memories of the last look


def newton(branch: Branch, guess: Six, remainder: Array, allowed: Scalar) -> Iterate:
    """The equilibrium near a guess, if there is one; `remainder` is that of a tangent nearby, tried where `allowed`."""
    there, met = _one_by_one(branch, guess, remainder, allowed)
    d = [jnp.where(met, a, b) for a, b in zip(there, guess, strict=True)]
    infinite, no = jnp.full_like(branch.step, jnp.inf), jnp.array(False)
    start = Iterate(d, infinite, no, no, remainder, jnp.where(met, 1, 0), no, branch.origin.memories)
    return jax.lax.while_loop(
        lambda at: ~at.done & (at.count < MOST_ITERATIONS), lambda at: _improved(branch, guess, at), start
    )


def _one_by_one(branch: Branch, guess: Six, remainder: Array, allowed: Scalar) -> tuple[Six, Scalar]:
    """Where a known remainder leads, and whether that is near a balance."""

    def improve(now: tuple[Six, Scalar, Scalar, Scalar]) -> tuple[Six, Scalar, Scalar, Scalar]:
        d, last, count, _ = now
        held = jnp.where(count == 0, branch.rates, 0.0)
        there = branch.look_around(d, held, neighbours=False)
        r = there.residual()
        size = norm(r)
        step, downhill = step_of(entries(_structured(branch, there) + remainder), r)
        better = downhill & (size < SLOW * last)
        size = jnp.where((count == 0) | ~better, jnp.inf, size)  # held on, it is another one's
        d = [jnp.where(better, a + b, a) for a, b in zip(d, step, strict=True)]
        return d, size, count + 1, better & (size > NEAR) & (count < MOST_SINGLE)

    start = guess, jnp.full_like(branch.step, jnp.inf), jnp.zeros((), int), allowed
    d, size, _, _ = jax.lax.while_loop(lambda now: now[3], improve, start)
    return d, (size < NEAR) & (_apart(d, guess) < FARTHEST)


def _improved(branch: Branch, guess: Six, at: Iterate) -> Iterate:
    """One Newton iteration; done where its step is short and leaves less than the tolerance."""
    dtype = branch.step.dtype
    held = jnp.where(at.count == 0, branch.rates, 0.0)
    there = branch.look_around(at.d, held)
    r, tangent = there.residual(), there.tangent()
    size = norm(r)
    step, stable = _downhill(branch, there, tangent, size)
    length = norm(step)
    balanced = (size < tolerance_of(dtype)) & (held == 0)
    lost = ~jnp.isfinite(length) | ~jnp.isfinite(size)
    stays = lost | (balanced & (length >= POLISH))
    scale = jnp.where(stays, 0.0, jnp.minimum(1.0, REACH / jnp.maximum(length, 1e-12)))
    d = [jnp.where(stays, a, a + scale * b) for a, b in zip(at.d, step, strict=True)]
    strayed = _apart(d, guess) > FARTHEST
    done = balanced | lost | (strayed & (branch.rates > 0))
    remainder = tangent - _structured(branch, there)
    return Iterate(d, size, balanced, stable, remainder, at.count + 1, done, there.memories)


def _apart(a: Six, b: Six) -> Scalar:
    return norm([x - y for x, y in zip(a, b, strict=True)])


def _matrix(rows: list[list[Scalar]]) -> Array:
    return jnp.stack([jnp.stack(row) for row in rows])


def _structured(branch: Branch, there: Surroundings) -> Array:
    """(6, 6): what stiff terms, beds and drags alone say of the tangent [N/m]."""
    return _matrix(there.convex()) + (branch.rates / branch.span()) * _matrix(there.viscosity())


def _downhill(branch: Branch, there: Surroundings, tangent: Array, size: Scalar) -> tuple[Six, Scalar]:
    """Newton's step where that leads downhill, and whether the tangent at rest, dashpots left out, is stable.

    Where the tangent is indefinite, the stiff terms' own positive semidefinite part takes its place. Both are shifted,
    which bounds a step by `REACH` and vanishes with the residual.
    """
    one, r = jnp.eye(6, dtype=size.dtype), there.residual()
    at_rest = tangent - (branch.rates / branch.span()) * _matrix(there.viscosity())
    shift = (size / REACH) * one
    matrices = jnp.stack([tangent + shift, _matrix(there.convex()) + shift])
    steps, definite = jax.vmap(lambda matrix: step_of(entries(matrix), r))(matrices)
    return [jnp.where(definite[0], a[0], a[1]) for a in steps], is_stable(at_rest)


def is_stable(tangent: Array) -> Scalar:
    """Whether a (6, 6) tangent at rest [N/m] is that of a stable or a neutral equilibrium.

    A definite symmetric part is enough. Where it is not definite, C = (K - s) (K + s)^-1 turns eigenvalues of positive
    real part into some below 1 in size, whose powers vanish, and the others into some above, whose powers grow.
    """
    one = jnp.eye(6, dtype=tangent.dtype)
    trace = jnp.trace(tangent)
    slack = trace * jnp.asarray(NEUTRAL, tangent.dtype)
    shifted = tangent + slack * one
    definite = inverse_with_pivots(0.5 * (shifted + shifted.T))[1]
    scale = jnp.asarray(NEUTRAL**0.5, tangent.dtype) * trace  # geometric mean of the slack and the trace

    def squared(now: tuple[Array, Scalar]) -> tuple[Array, Scalar]:
        power, count = now
        first = one - 2 * scale * inverse_with_pivots(power + scale * one)[0]
        return jnp.where(count == 0, first, power @ power), count + 1

    # Not one round where the symmetric part is definite, as it is wherever forces have a potential.
    most = jnp.where(definite, 0, SQUARINGS + 1)
    power, _ = jax.lax.while_loop(lambda now: now[1] < most, squared, (shifted, jnp.zeros_like(most)))
    return definite | ((trace > 0) & (jnp.max(jnp.abs(power)) < 1))
