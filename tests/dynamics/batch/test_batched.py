"""Batches are computed in pieces of a good size, and nobody sees it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.dynamics.batch.batched import ALIASING, FILL, PIECE, batched, good_sizes


@pytest.mark.parametrize("n", [1, 7, ALIASING - 1, ALIASING, ALIASING + 1, PIECE, PIECE + 1, 16 * ALIASING])
def test_a_batch_of_any_size_is_what_vmap_gives(n):
    x, tree = jnp.arange(2.0 * n).reshape(n, 2), {"a": jnp.arange(float(n))}

    def function(row, more):
        return row.sum() + more["a"], jnp.sin(row)

    for ours, plain in zip(batched(function)(x, tree), jax.vmap(function)(x, tree), strict=True):
        np.testing.assert_array_equal(ours, plain)
    slopes = jax.jit(jax.jacfwd(lambda t: batched(lambda a: t * a)(x)))(2.0)
    np.testing.assert_array_equal(slopes, x)


@pytest.mark.parametrize("n", [1, ALIASING, PIECE, PIECE + 1, 1000, 1024, 10_007])
def test_sizes(n):
    pieces, size = good_sizes(n)
    assert pieces * size >= n
    assert size <= PIECE + FILL
    assert size % ALIASING
    assert (pieces - 1) * size < n + pieces * FILL  # hardly more than there are
