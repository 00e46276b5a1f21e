"""The elimination against numpy's dense solution of the whole system, and its derivative rule against differences."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.dynamics.integrators.end_of_step import ConstraintRow, end_of_step

TERMS = 4  # two of them unilateral


def problem(seed: int, dense: bool):
    """Mass matrix (its lower triangle, or its diagonal), directions, impulses, weights and rest."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(6, 6))
    mass = a @ a.T + 0.2 * np.eye(6) if dense else np.diag(rng.uniform(0.05, 0.3, 6))
    weights = 10.0 ** rng.uniform(-3, 3, TERMS)  # from slack to far stiffer than the mass
    return mass, rng.normal(size=(TERMS, 6)), rng.uniform(0.5, 2.0, TERMS), weights, rng.normal(size=6)


def solved(mass, g, impulses, weights, rest, dense: bool):
    lower = [[mass[i, j] for j in range(i + 1)] for i in range(6)] if dense else [mass[i, i] for i in range(6)]
    pushes = [ConstraintRow(list(g[i]), impulses[i], weights[i], i >= TERMS - 2) for i in range(TERMS)]
    dv, p = end_of_step(lower, pushes, list(rest))
    return jnp.stack(dv), jnp.stack(p)


def reference(mass, g, impulses, weights, rest, active):
    """One system of all unknowns: M dv - G^T p = R and w g . dv + p = P; inactive terms have no impulse."""
    k = len(impulses)
    matrix = np.block([[mass, -g.T], [np.where(active, weights, 0.0)[:, None] * g, np.eye(k)]])
    x = np.linalg.solve(matrix, np.concatenate([rest, np.where(active, impulses, 0.0)]))
    return x[:6], x[6:]


@pytest.mark.parametrize("dense", [False, True], ids=["diagonal", "dense"])
def test_against_the_whole_system(dense):
    taken_out = 0
    solve = jax.jit(solved, static_argnums=5)
    for seed in range(40):
        data = problem(seed, dense)
        dv, p = (np.asarray(a) for a in solve(*(jnp.asarray(a) for a in data), dense))
        tried = reference(*data, np.ones(TERMS, bool))[1]
        active = np.array([True] * (TERMS - 2) + [bool(x > 0) for x in tried[-2:]])
        expected = reference(*data, active)
        np.testing.assert_allclose(dv, expected[0], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(p, expected[1], rtol=1e-8, atol=1e-8)
        assert np.all(p[~active] == 0)
        taken_out += np.sum(~active)
    assert taken_out > 5


@pytest.mark.parametrize("dense", [False, True], ids=["diagonal", "dense"])
@pytest.mark.parametrize("seed", range(4))
def test_its_derivative_is_that_of_the_solution(seed, dense):
    """By every input at once, in both modes; some of these have a term taken out."""
    data = [jnp.asarray(a) for a in problem(seed, dense)]
    rng = np.random.default_rng(seed + 100)
    along = [jnp.asarray(rng.normal(size=a.shape)) for a in data]
    along[0] = along[0] + along[0].T if dense else jnp.diag(jnp.diag(along[0]))
    along[0], along[3] = 0.01 * along[0], data[3] * along[3] * 0.1

    def shifted(t):
        return jnp.concatenate(solved(*(a + t * d for a, d in zip(data, along, strict=True)), dense))

    h = 1e-6
    numeric = (shifted(h) - shifted(-h)) / (2 * h)
    forward = jax.jacfwd(shifted)(0.0)
    scale = float(jnp.abs(numeric).max())
    np.testing.assert_allclose(forward, numeric, atol=1e-6 * scale)
    np.testing.assert_allclose(jax.jacrev(shifted)(0.0), forward, atol=1e-10 * scale)
