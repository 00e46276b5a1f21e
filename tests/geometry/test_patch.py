"""Polynomial patches: value, gradient, Hessian against numpy and automatic differentiation; C1 past the edge."""

from __future__ import annotations

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


def points(reach: float, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.random.default_rng(1).uniform(-reach, reach, (2, n))
    return CENTER[0] + HALF[0] * a, CENTER[1] + HALF[1] * b


@pytest.mark.parametrize("degree", [0, 1, 2, 4, 5, 8])
def test_jet_inside_against_numpy_and_automatic_differentiation(degree):
    patch = random_patch(degree)
    u, v = points(0.99)
    square = np.zeros((degree + 1, degree + 1))
    for (i, j), c in zip(exponents(degree), np.asarray(patch.coefficients), strict=True):
        square[i, j] = c
    expected = np.polynomial.polynomial.polyval2d((u - CENTER[0]) / HALF[0], (v - CENTER[1]) / HALF[1], square)

    @jax.jit
    def everything(u, v):
        def height(u, v):
            return patch.height(u, v)

        first = [jax.vmap(jax.grad(height, k))(u, v) for k in (0, 1)]
        (uu, uv), (_, vv) = jax.vmap(jax.hessian(height, (0, 1)))(u, v)
        return patch.jet(u, v), (*first, uu, uv, vv)

    jet, derivatives = everything(J(u), J(v))
    np.testing.assert_allclose(jet.f, expected, atol=1e-17)
    for closed_form, automatic in zip(jet[1:], derivatives, strict=True):
        np.testing.assert_allclose(closed_form, automatic, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("degree", [2, 5])
def test_beyond_the_edge_slopes_belong_to_the_height(degree):
    patch = random_patch(degree)
    u, v = points(3.0, 200)
    beyond = np.asarray(patch.outside(J(u), J(v))) > 0
    assert 20 < beyond.sum() < 200
    slopes = jax.jit(jax.vmap(jax.grad(patch.height, (0, 1))))(J(u), J(v))
    jet = patch.jet(J(u), J(v))
    np.testing.assert_allclose(jet.u, slopes[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(jet.v, slopes[1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("degree", [2, 5])
def test_beyond_the_edge_curvatures_belong_to_the_height(degree):
    patch = random_patch(degree)
    u, v = (J(x) for x in points(3.0, 200))
    (uu, uv), (_, vv) = jax.jit(jax.vmap(jax.hessian(patch.height, (0, 1))))(u, v)
    jet = patch.jet(u, v)
    for own, automatic in ((jet.uu, uu), (jet.uv, uv), (jet.vv, vv)):
        np.testing.assert_allclose(own, automatic, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("degree", [2, 5])
def test_value_and_slope_are_continuous_across_the_edge(degree):
    patch = random_patch(degree)
    along = np.linspace(-1.5, 1.5, 31)  # past the corners as well
    for side in (-1, 1):
        for across_u in (True, False):
            edge = []
            for offset in (-1e-10, 1e-10):
                s = np.full_like(along, side + offset)
                a, b = (s, along) if across_u else (along, s)
                edge.append(patch.jet(J(CENTER[0] + HALF[0] * a), J(CENTER[1] + HALF[1] * b)))
            for name, tolerance in (("f", 1e-11), ("u", 1e-8), ("v", 1e-8)):
                np.testing.assert_allclose(getattr(edge[0], name), getattr(edge[1], name), atol=tolerance)


def test_it_goes_on_straight_and_never_folds_back():
    patch = random_patch(8)
    out = np.linspace(1, 50, 20)
    height = np.asarray(patch.height(J(CENTER[0] + HALF[0] * out), J(np.full(20, CENTER[1]))))
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
    np.testing.assert_array_equal(patch.height(u, v), patch.unstacked().height(u, v))
