"""Solver for the equilibrium near a guess: a cheap quasi-Newton iteration, then Newton's method if that fails.

The cheap iteration evaluates one pose per iterate. Its tangent is the stiffness of the stiff terms at that pose plus a
remainder, the other part of the last exact tangent, which changes little from step to step. Once the residual is small,
one evaluation of the pose and its twelve neighbours gives the exact tangent, which decides whether the equilibrium is
stable, removes the rest of the residual, and provides the remainder for the next step. If an iteration does not halve
the residual, Newton's method starts again from the guess, with the exact tangent at every iterate.

An equilibrium is stable if a disturbance decays in a viscous medium without inertia, d' = -K d / c, so if every
eigenvalue of K has a positive real part. If forces have a potential, K is then positive definite. Those of mesh
contours have none: the symmetric part of their K is often indefinite, and does not indicate a fold.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar
from pftwin.dynamics.equilibrium import LONGEST_STEP, entries, step_of, tolerance_of
from pftwin.dynamics.quasi_static.branch import Branch, norm
from pftwin.dynamics.solve import Six, inverse_with_pivots
from pftwin.dynamics.static_load import Surroundings

MOST_ITERATIONS = 20  # iterations with the exact tangent
MOST_SINGLE = 8  # cheap iterations, which evaluate one pose
SLOW = 0.5  # largest ratio of successive residuals in the cheap iteration; it is abandoned above
FARTHEST = 5e-3  # an equilibrium farther than this from the predicted pose counts as a different one [m]
NEAR = 1e-5  # residual below which one more cheap step suffices before the exact evaluation [N]
POLISH = 1e-6  # longest last step that is taken without another evaluation [m]
NEUTRAL = 1e-6  # fraction of the tangent's trace: a negative stiffness up to that size counts as neutral, not unstable
SQUARINGS = 16  # reduce a factor 0.2 % below 1, as from eigenvalues of the size of slack or trace, to about 1e-57


class Iterate(NamedTuple):
    """State of the iteration."""

    d: Six
    size: Scalar  # norm of the residual before the last step [N]
    settled: Scalar  # whether `size` is below the tolerance
    stable: Scalar
    remainder: Array  # (6, 6) of the tangent [N/m]
    count: Scalar
    done: Scalar
    trial: tuple[Any, ...]  # memories after the last evaluation


def newton(branch: Branch, guess: Six, remainder: Array, allowed: Scalar) -> Iterate:
    """The equilibrium near a guess, if any; the cheap iteration uses `remainder` and runs only where `allowed`."""
    there, met = _cheap_iteration(branch, guess, remainder, allowed)
    d = [jnp.where(met, a, b) for a, b in zip(there, guess, strict=True)]
    infinite, no = jnp.full_like(branch.step, jnp.inf), jnp.array(False)
    start = Iterate(d, infinite, no, no, remainder, jnp.where(met, 1, 0), no, branch.origin.memories)
    return jax.lax.while_loop(
        lambda at: ~at.done & (at.count < MOST_ITERATIONS), lambda at: _improved(branch, guess, at), start
    )


def _cheap_iteration(branch: Branch, guess: Six, remainder: Array, allowed: Scalar) -> tuple[Six, Scalar]:
    """Displacement after the cheap iteration with a known remainder, and whether it nearly balances the load."""

    def improve(now: tuple[Six, Scalar, Scalar, Scalar]) -> tuple[Six, Scalar, Scalar, Scalar]:
        d, last, count, _ = now
        held = jnp.where(count == 0, branch.rates, 0.0)
        there = branch.look_around(d, held, neighbours=False)
        r = there.residual()
        size = norm(r)
        step, downhill = step_of(entries(_structured(branch, there) + remainder), r)
        better = downhill & (size < SLOW * last)
        size = jnp.where((count == 0) | ~better, jnp.inf, size)  # with `held`, the residual is that of another problem
        d = [jnp.where(better, a + b, a) for a, b in zip(d, step, strict=True)]
        return d, size, count + 1, better & (size > NEAR) & (count < MOST_SINGLE)

    start = guess, jnp.full_like(branch.step, jnp.inf), jnp.zeros((), int), allowed
    d, size, _, _ = jax.lax.while_loop(lambda now: now[3], improve, start)
    return d, (size < NEAR) & (_distance(d, guess) < FARTHEST)


def _improved(branch: Branch, guess: Six, at: Iterate) -> Iterate:
    """One Newton iteration with the exact tangent; done if the residual was below the tolerance, or on failure."""
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
    scale = jnp.where(stays, 0.0, jnp.minimum(1.0, LONGEST_STEP / jnp.maximum(length, 1e-12)))
    d = [jnp.where(stays, a, a + scale * b) for a, b in zip(at.d, step, strict=True)]
    strayed = _distance(d, guess) > FARTHEST
    done = balanced | lost | (strayed & (branch.rates > 0))
    remainder = tangent - _structured(branch, there)
    return Iterate(d, size, balanced, stable, remainder, at.count + 1, done, there.memories)


def _distance(a: Six, b: Six) -> Scalar:
    return norm([x - y for x, y in zip(a, b, strict=True)])


def _matrix(rows: list[list[Scalar]]) -> Array:
    return jnp.stack([jnp.stack(row) for row in rows])


def _structured(branch: Branch, there: Surroundings) -> Array:
    """(6, 6) contribution of stiff terms, foundations and drags to the tangent [N/m]."""
    return _matrix(there.convex()) + (branch.rates / branch.span()) * _matrix(there.viscosity())


def _downhill(branch: Branch, there: Surroundings, tangent: Array, size: Scalar) -> tuple[Six, Scalar]:
    """Newton's step, and whether the tangent at rest, without dashpots, is stable.

    Where the tangent is indefinite, the positive semidefinite stiffness of the stiff terms replaces it. A shift of
    both, which vanishes with the residual, bounds a step by `LONGEST_STEP`.
    """
    one, r = jnp.eye(6, dtype=size.dtype), there.residual()
    at_rest = tangent - (branch.rates / branch.span()) * _matrix(there.viscosity())
    shift = (size / LONGEST_STEP) * one
    matrices = jnp.stack([tangent + shift, _matrix(there.convex()) + shift])
    steps, definite = jax.vmap(lambda matrix: step_of(entries(matrix), r))(matrices)
    return [jnp.where(definite[0], a[0], a[1]) for a in steps], is_stable(at_rest)


def is_stable(tangent: Array) -> Scalar:
    """Whether a (6, 6) tangent at rest [N/m] belongs to a stable or neutral equilibrium.

    A positive definite symmetric part is sufficient. Otherwise C = (K - s) (K + s)^-1 maps eigenvalues with a positive
    real part to magnitudes below 1, whose powers vanish, and the others to magnitudes above 1, whose powers grow.
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

    # No iteration where the symmetric part is definite, as at every stable equilibrium of forces with a potential.
    most = jnp.where(definite, 0, SQUARINGS + 1)
    power, _ = jax.lax.while_loop(lambda now: now[1] < most, squared, (shifted, jnp.zeros_like(most)))
    return definite | ((trace > 0) & (jnp.max(jnp.abs(power)) < 1))
