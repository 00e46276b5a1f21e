"""Small systems of equations, written out: against NumPy's, and what they say of definiteness."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.dynamics.solve import add_outer, eliminate, factor, inverse_with_pivots, solve

RANDOM = np.random.default_rng(0)
HALF = RANDOM.normal(size=(6, 6)) * np.logspace(-2, 1, 6)[:, None]
POSITIVE = HALF @ HALF.T
RIGHT = RANDOM.normal(size=6)


def lower(matrix):
    return [[jnp.asarray(matrix[i, j]) for j in range(i + 1)] for i in range(len(matrix))]


def whole(triangle):
    low = np.array([[*(float(x) for x in row), *[0.0] * (6 - len(row))] for row in triangle])
    return low + np.tril(low, -1).T


def test_a_term_adds_its_outer_product():
    g, weight = RANDOM.normal(size=6), 3.7
    found = add_outer(lower(POSITIVE), list(jnp.asarray(g)), jnp.asarray(weight))
    np.testing.assert_allclose(whole(found), POSITIVE + weight * np.outer(g, g), rtol=1e-12)
    group, weights = RANDOM.normal(size=(6, 3)), np.array([0.5, 2.0, 7.0])
    found = add_outer(lower(POSITIVE), list(jnp.asarray(group)), jnp.asarray(weights))
    np.testing.assert_allclose(whole(found), POSITIVE + (weights * group) @ group.T, rtol=1e-12)


def test_symmetric_systems_and_their_pivots():
    """The pivots of L D L^T are ratios of leading minors."""
    low, inverse = factor(lower(POSITIVE))
    np.testing.assert_allclose(
        solve(low, inverse, list(jnp.asarray(RIGHT))), np.linalg.solve(POSITIVE, RIGHT), rtol=1e-8
    )
    minors = [1.0, *(np.linalg.det(POSITIVE[:k, :k]) for k in range(1, 7))]
    np.testing.assert_allclose(inverse, np.divide(minors[:-1], minors[1:]), rtol=1e-6)


def test_systems_without_symmetry():
    matrix = POSITIVE + 0.3 * RANDOM.normal(size=(6, 6)) + 3 * np.eye(6)
    found, inverse = eliminate([list(row) for row in jnp.asarray(matrix)], list(jnp.asarray(RIGHT)))
    np.testing.assert_allclose(found, np.linalg.solve(matrix, RIGHT), rtol=1e-9)
    assert np.prod(inverse) == pytest.approx(1 / np.linalg.det(matrix))


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
