"""Polynomial patches: value, gradient, Hessian against numpy and automatic differentiation; C1 past the edge."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import patch_of

from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents

J = jnp.asarray
HALF = (0.024, 0.02)
CENTER = (0.003, -0.001)


def random_patch(degree: int, seed: int = 0) -> PolynomialPatch:
    c = 1e-3 * np.random.default_rng(seed).normal(size=len(exponents(degree)))
    patch = patch_of(c, degree, HALF)
    return PolynomialPatch(patch.chart, patch.coefficients, (J(CENTER[0]), J(CENTER[1])), patch.half_size, degree)


N = 200  # points at once, everywhere: one program of each kind serves all tests of a degree


def points(reach: float) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.random.default_rng(1).uniform(-reach, reach, (2, N))
    return CENTER[0] + HALF[0] * a, CENTER[1] + HALF[1] * b


@eqx.filter_jit
def height_of(patch, u, v):
    return patch.height(u, v)


@eqx.filter_jit
def jets(patch, u, v):
    """The patch's own, and the height's derivatives by JAX in the same order."""
    first = jax.vmap(jax.grad(patch.height, (0, 1)))(u, v)
    (uu, uv), (_, vv) = jax.vmap(jax.hessian(patch.height, (0, 1)))(u, v)
    return patch.jet(u, v), (*first, uu, uv, vv)


@pytest.mark.parametrize("degree", [0, 1, 2, 4, 5, pytest.param(8, marks=pytest.mark.slow)])
def test_jet_inside_against_numpy_and_automatic_differentiation(degree):
    patch = random_patch(degree)
    u, v = points(0.99)
    square = np.zeros((degree + 1, degree + 1))
    for (i, j), c in zip(exponents(degree), np.asarray(patch.coefficients), strict=True):
        square[i, j] = c
    expected = np.polynomial.polynomial.polyval2d((u - CENTER[0]) / HALF[0], (v - CENTER[1]) / HALF[1], square)

    jet, derivatives = jets(patch, J(u), J(v))
    np.testing.assert_allclose(jet.f, expected, atol=1e-17)
    for closed_form, automatic in zip(jet[1:], derivatives, strict=True):
        np.testing.assert_allclose(closed_form, automatic, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("degree", [2, 5])
def test_beyond_the_edge_slopes_and_curvatures_belong_to_the_height(degree):
    patch = random_patch(degree)
    u, v = (J(x) for x in points(3.0))
    beyond = np.asarray(patch.outside(u, v)) > 0
    assert 20 < beyond.sum() < N
    jet, derivatives = jets(patch, u, v)
    for own, automatic, atol in zip(jet[1:], derivatives, (1e-12, 1e-12, 1e-10, 1e-10, 1e-10), strict=True):
        np.testing.assert_allclose(own, automatic, rtol=1e-9, atol=atol)


@pytest.mark.parametrize("degree", [2, 5])
def test_value_and_slope_are_continuous_across_the_edge(degree):
    patch = random_patch(degree)
    along = np.linspace(-1.5, 1.5, N)  # past the corners as well
    for side in (-1, 1):
        for across_u in (True, False):
            edge = []
            for offset in (-1e-10, 1e-10):
                s = np.full_like(along, side + offset)
                a, b = (s, along) if across_u else (along, s)
                edge.append(jets(patch, J(CENTER[0] + HALF[0] * a), J(CENTER[1] + HALF[1] * b))[0])
            for name, tolerance in (("f", 1e-11), ("u", 1e-8), ("v", 1e-8)):
                np.testing.assert_allclose(getattr(edge[0], name), getattr(edge[1], name), atol=tolerance)


def test_it_goes_on_straight_and_never_folds_back():
    patch = random_patch(8)
    out = np.linspace(1, 50, N)
    height = np.asarray(height_of(patch, J(CENTER[0] + HALF[0] * out), J(np.full(N, CENTER[1]))))
    np.testing.assert_allclose(np.diff(height, 2), 0, atol=1e-15 + 1e-12 * np.ptp(height))


def test_outside_is_the_distance_beyond_the_rectangle():
    patch = random_patch(2)
    u = CENTER[0] + np.array([0, 0.024, 0.025, -0.030, 0.0, 0.026])
    v = CENTER[1] + np.array([0, -0.02, 0.0, 0.0, -0.023, 0.025])
    np.testing.assert_allclose(patch.outside(J(u), J(v)), [0, 0, 0.001, 0.006, 0.003, 0.005], atol=1e-12)


def test_unstacked_coefficients_say_the_same():
    patch = random_patch(5)
    assert patch.unstacked().unstacked() == patch.unstacked()
    u, v = (J(x) for x in points(1.5))
    np.testing.assert_array_equal(height_of(patch, u, v), height_of(patch.unstacked(), u, v))


@pytest.mark.parametrize("degree", [2, 5])
def test_waves_are_a_legendre_series_over_the_rectangle(degree):
    """Added to the patch, of a lower degree or a higher: as `numpy.polynomial.legendre` has it."""
    patch, series = random_patch(degree), np.random.default_rng(6).normal(size=(4, 4)) * np.tri(4)[::-1]
    a, b = np.random.default_rng(7).uniform(-1, 1, (2, N))
    u, v = J(CENTER[0] + HALF[0] * a), J(CENTER[1] + HALF[1] * b)
    added = height_of(patch.with_waves(series), u, v) - height_of(patch, u, v)
    np.testing.assert_allclose(added, np.polynomial.legendre.legval2d(a, b, series), rtol=1e-9, atol=1e-12)
