"""The inverse of a small matrix, and whether the matrix is positive definite.

A loop over the pivots. XLA recomputes the result of an unrolled version wherever it is used, and a call to LAPACK keeps
it from compiling a loop of time steps as one function.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar


def inverse_with_pivots(matrix: Array) -> tuple[Array, Scalar]:
    """The inverse of an (n, n) matrix that is definite or nearly so, and whether all its pivots are positive.

    The largest pivot left on the diagonal comes first. Where the matrix is symmetric, positive pivots show that it is
    positive definite; where a pivot is zero, the answer is not finite.
    """
    n = matrix.shape[0]

    def sweep(_: int, now: tuple[Array, Array, Scalar]) -> tuple[Array, Array, Scalar]:
        a, used, positive = now
        size = jnp.where(used, -1.0, jnp.abs(jnp.diagonal(a)))
        here = jnp.arange(n) == jnp.argmax(size)
        row = jnp.sum(jnp.where(here[:, None], a, 0.0), axis=0)
        column = jnp.sum(jnp.where(here[None, :], a, 0.0), axis=1)
        pivot = jnp.sum(jnp.where(here, row, 0.0))
        # With the pivot's row and column set like this, one formula updates all entries.
        row, column = jnp.where(here, 1.0, row) / pivot, jnp.where(here, -1.0, column)
        rest = jnp.where(here[:, None] | here[None, :], 0.0, a)
        return rest - column[:, None] * row[None, :], used | here, positive & (pivot > 0)

    start = matrix, jnp.zeros(n, bool), jnp.isfinite(matrix).all()
    inverse, _, positive = jax.lax.fori_loop(0, n, sweep, start)
    return inverse, positive
