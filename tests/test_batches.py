"""Batches are filled up where that is faster, and nobody sees it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.batches import ALIASING, batched, good_size


@pytest.mark.parametrize("n", [1, 7, ALIASING - 1, ALIASING, ALIASING + 1, 8 * ALIASING])
def test_a_batch_of_any_size_is_what_vmap_gives(n):
    x, tree = jnp.arange(2.0 * n).reshape(n, 2), {"a": jnp.arange(float(n))}

    def function(row, more):
        return row.sum() + more["a"], jnp.sin(row)

    for ours, plain in zip(batched(function)(x, tree), jax.vmap(function)(x, tree), strict=True):
        np.testing.assert_array_equal(ours, plain)
    slopes = jax.jit(jax.jacfwd(lambda t: batched(lambda a: t * a)(x)))(2.0)
    np.testing.assert_array_equal(slopes, x)


def test_sizes():
    assert good_size(1000) == 1000
    assert good_size(1024) > 1024
    assert good_size(good_size(1024)) == good_size(1024)
