"""Small systems of linear equations, and derivatives of implicitly defined functions.

`factor`, `solve` and `eliminate` are unrolled into scalar operations, which XLA keeps in registers. They do not pivot,
as callers pass matrices that are positive definite or nearly so. `inverse_with_pivots` loops over the pivots instead:
XLA would recompute the result of an unrolled version at every use, and a call to LAPACK would prevent it from compiling
a loop of time steps as one function.

The solution x(p) of six equations r(x, p) = 0 has the derivative dx = -(dr/dx)^-1 (dr/dp) dp, however it was computed.
XLA recomputes scalars for every entry of an array into which they are stacked. So the columns of dr/dx pass through the
carry of a loop, which stores them, and right-hand sides are never stacked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.leaves import split_by_tangent
from pftwin.base.spatial import Scalar, Vec3

Lower = list[list[Scalar]]  # row i holds columns 0..i


def add_outer(a: Lower, g: Sequence[Scalar], weight: Scalar) -> Lower:
    """a + w g g^T, summed over the leading axis of a group of terms, if any."""
    if jnp.ndim(weight):
        # Sums instead of a matrix product, which would keep XLA from fusing a step into one loop.
        rows = [jnp.broadcast_to(x, weight.shape) for x in g]
        weighted = [weight * x for x in rows]
        return [[entry + jnp.sum(weighted[i] * rows[j]) for j, entry in enumerate(row)] for i, row in enumerate(a)]
    weighted = [weight * x for x in g]
    return [[entry + weighted[i] * g[j] for j, entry in enumerate(row)] for i, row in enumerate(a)]


def factor(a: Lower) -> tuple[Lower, list[Scalar]]:
    """LDL^T factorisation without pivoting: unit lower triangle L (without its diagonal), and 1 / D.

    The matrix is not positive definite if an entry of D is not positive.
    """
    n = len(a)
    low: Lower = [[] for _ in range(n)]
    inverse: list[Scalar] = []
    for i in range(n):
        scaled: list[Scalar] = []  # L_ij D_j
        for j in range(i):
            entry = a[i][j]
            for k in range(j):
                entry = entry - scaled[k] * low[j][k]
            scaled.append(entry)
        low[i] = [s * d for s, d in zip(scaled, inverse, strict=True)]
        pivot = a[i][i]
        for s, x in zip(scaled, low[i], strict=True):
            pivot = pivot - s * x
        inverse.append(1 / pivot)
    return low, inverse


def solve(low: Lower, inverse: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    """Solves L D L^T x = b for x, with the result of `factor`."""
    n = len(b)
    y = list(b)
    for i in range(n):
        for j in range(i):
            y[i] = y[i] - low[i][j] * y[j]
    y = [v * d for v, d in zip(y, inverse, strict=True)]
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            y[i] = y[i] - low[j][i] * y[j]
    return y


def eliminate(a: Sequence[Sequence[Scalar]], b: Sequence[Scalar]) -> tuple[list[Scalar], list[Scalar]]:
    """Solves a x = b by Gaussian elimination without pivoting; returns x and the inverse pivots.

    A symmetric matrix is not positive definite if a pivot is not positive.
    """
    n, rows, t = len(b), [list(row) for row in a], list(b)
    inverse: list[Scalar] = []
    for k in range(n):
        inverse.append(1 / rows[k][k])
        for i in range(k + 1, n):
            multiplier = rows[i][k] * inverse[k]
            t[i] = t[i] - multiplier * t[k]
            rows[i] = [x - multiplier * rows[k][j] if j > k else x for j, x in enumerate(rows[i])]
    for k in reversed(range(n)):
        for j in range(k + 1, n):
            t[k] = t[k] - rows[k][j] * t[j]
        t[k] = t[k] * inverse[k]
    return t, inverse


def inverse_with_pivots(matrix: Array) -> tuple[Array, Scalar]:
    """Inverse of an (n, n) matrix that is definite or nearly so, and whether all its pivots are positive.

    Pivots are taken from the diagonal, the largest remaining one first. A symmetric matrix with positive pivots is
    positive definite; if a pivot is zero, the result is not finite.
    """
    n = matrix.shape[0]

    def eliminate_pivot(_: int, now: tuple[Array, Array, Scalar]) -> tuple[Array, Array, Scalar]:
        a, used, positive = now
        size = jnp.where(used, -1.0, jnp.abs(jnp.diagonal(a)))
        here = jnp.arange(n) == jnp.argmax(size)
        row = jnp.sum(jnp.where(here[:, None], a, 0.0), axis=0)
        column = jnp.sum(jnp.where(here[None, :], a, 0.0), axis=1)
        pivot = jnp.sum(jnp.where(here, row, 0.0))
        # Sets the pivot's row and column such that one formula updates all entries.
        row, column = jnp.where(here, 1.0, row) / pivot, jnp.where(here, -1.0, column)
        rest = jnp.where(here[:, None] | here[None, :], 0.0, a)
        return rest - column[:, None] * row[None, :], used | here, positive & (pivot > 0)

    start = matrix, jnp.zeros(n, bool), jnp.isfinite(matrix).all()
    inverse, _, positive = jax.lax.fori_loop(0, n, eliminate_pivot, start)
    return inverse, positive


Six = list[Scalar]  # components of a force and moment, or of a displacement and rotation


def six(a: Vec3, b: Vec3) -> Six:
    """The components of two vectors."""
    return [a.x, a.y, a.z, b.x, b.y, b.z]


def tangent_of(residual: Callable[[Six], Six], x: Six) -> Array:
    """Jacobian (6, 6), dr_i/dx_j in row i and column j, computed one column at a time."""

    def one(last: Six, direction: Array) -> tuple[Six, Array]:
        change = jax.jvp(residual, (x,), ([direction[i] for i in range(6)],))[1]
        return change, jnp.stack(last)

    directions = jnp.eye(7, 6, dtype=x[0].dtype)  # an additional row, as each column is stored in the next iteration
    return jax.lax.scan(one, [jnp.zeros_like(a) for a in x], directions)[1][1:].T


def changed_by(function: Callable[[Any], Any], values: Any, changes: Any) -> Any:
    """Tangent of function(values) for tangents of the values; None marks a constant value."""
    moving, still = split_by_tangent(values, changes)
    return jax.jvp(lambda m: function(eqx.combine(m, still)), (moving,), (changes,))[1]


def solution_changes(tangent: Array, right: Six) -> Six:
    """Tangent of the solution: -(dr/dx)^-1 times the tangent of the residual at constant x."""
    inverse, _ = inverse_with_pivots(tangent)
    rows = [[inverse[i, j] * r for j, r in enumerate(right)] for i in range(6)]
    return [-sum(row[1:], start=row[0]) for row in rows]
