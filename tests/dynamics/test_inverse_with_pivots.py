"""The inverse by sweeping: against the library's, and what it says of definiteness."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from pftwin.dynamics.solve import inverse_with_pivots

RANDOM = np.random.default_rng(0)
HALF = RANDOM.normal(size=(6, 6)) * np.logspace(-2, 1, 6)[:, None]
POSITIVE = HALF @ HALF.T


def test_the_largest_pivot_comes_first():
    """Rows of very different size, not symmetric, and a first entry that is nearly none."""
    matrix = POSITIVE + 1e-3 * RANDOM.normal(size=(6, 6))
    matrix[0, 0] = 1e-14
    found = np.asarray(jax.jit(inverse_with_pivots)(jnp.asarray(matrix))[0])
    exact = np.linalg.inv(matrix)
    np.testing.assert_allclose(found, exact, rtol=1e-7, atol=1e-9 * np.abs(exact).max())


def test_whether_a_matrix_is_positive_definite():
    values, vectors = np.linalg.eigh(POSITIVE)
    for least, expected in ((values[0], True), (-1e-3 * values[0], False), (-values[-1], False)):
        matrix = (vectors * [least, *values[1:]]) @ vectors.T
        assert bool(inverse_with_pivots(jnp.asarray(matrix))[1]) is expected
    assert not bool(inverse_with_pivots(jnp.asarray(POSITIVE).at[2, 3].set(jnp.nan))[1])
