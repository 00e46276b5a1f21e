"""Small systems of linear equations, unrolled into scalar operations that XLA keeps in registers.

No function here pivots: callers pass matrices that are positive definite, or nearly so."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp

from pftwin.base.spatial import Scalar

Lower = list[list[Scalar]]  # row i holds columns 0..i


def add_outer(a: Lower, g: Sequence[Scalar], weight: Scalar) -> Lower:
    """a + w g g^T; entries with a leading axis (a group of terms) are summed over it."""
    if jnp.ndim(weight):
        # Sums rather than a matrix product: XLA does not fuse a step that holds a matrix product into one loop.
        rows = [jnp.broadcast_to(x, weight.shape) for x in g]
        weighted = [weight * x for x in rows]
        return [[entry + jnp.sum(weighted[i] * rows[j]) for j, entry in enumerate(row)] for i, row in enumerate(a)]
    weighted = [weight * x for x in g]
    return [[entry + weighted[i] * g[j] for j, entry in enumerate(row)] for i, row in enumerate(a)]


def factor(a: Lower) -> tuple[Lower, list[Scalar]]:
    """LDL^T without pivoting: unit lower triangle (its diagonal left out) and the inverse of the diagonal D.

    A diagonal entry of D that is not positive shows that the matrix is not positive definite.
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
    """x with L D L^T x = b, from `factor`'s answer."""
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
    """x with a x = b by Gaussian elimination, and the inverse pivots.

    Where `a` is symmetric, a pivot that is not positive shows that it is not positive definite.
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
