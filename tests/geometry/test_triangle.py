"""The nearest point of a triangle, and its derivatives on faces, edges and corners."""

from __future__ import annotations

import brute_force
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pftwin.base.spatial import Vec3
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle

CORNERS = np.array([[0.0, 0, 0], [0.03, 0, 0], [0.01, 0.02, 0]])
# Above the face, beyond each edge, beyond each corner.
PLACES = {
    0: (0.012, 0.006, 0.005),
    1: (0.015, -0.01, 0.004),
    2: (0.03, 0.02, 0.002),
    3: (-0.005, 0.015, -0.003),
    4: (-0.01, -0.01, 0.003),
    5: (0.05, -0.005, 0.001),
    6: (0.01, 0.04, -0.002),
}


@jax.jit
def look(rows, p):
    found = closest_on_triangle(Triangle.of_rows(rows.reshape(*rows.shape[:-2], 9)), Vec3.from_array(p))
    return found.point.array(), found.square, found.feature


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_as_near_as_the_brute_force_says(seed):
    rng = np.random.default_rng(seed)
    rows = rng.uniform(-0.05, 0.05, (50, 3, 3))
    rows[:10, 2] = rows[:10, 1] + 1e-6 * rng.normal(size=(10, 3))  # needles
    rows[10, 2] = rows[10, 0]
    p = np.broadcast_to(rng.uniform(-0.06, 0.06, 3), (50, 3))
    found, square, _ = look(rows, p)
    expected = brute_force.distances(rows, p[0])
    np.testing.assert_allclose(np.sqrt(square), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found - p, axis=1), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("feature", PLACES)
@pytest.mark.slow
def test_features_and_derivatives(feature):
    p = jnp.asarray(PLACES[feature])
    assert int(look(CORNERS, p)[2]) == feature

    def distance(corners, q):
        return jnp.sqrt(look(corners, q)[1])

    at = np.asarray(look(CORNERS, p)[0])
    d_corners, d_p = jax.grad(distance, argnums=(0, 1))(jnp.asarray(CORNERS), p)
    np.testing.assert_allclose(d_p, (p - at) / np.linalg.norm(p - at), atol=1e-12)  # the envelope theorem
    np.testing.assert_allclose(d_corners.sum(axis=0), -d_p, atol=1e-12)  # moved along with it, nothing changes
    for f in (lambda c, q: look(c, q)[0], lambda c, q: distance(c, q)[None]):
        forward, reverse = jax.jacfwd(f, (0, 1))(CORNERS, p), jax.jacrev(f, (0, 1))(CORNERS, p)
        e = 1e-7
        for i, (a, b) in enumerate(zip(forward, reverse, strict=True)):
            np.testing.assert_allclose(a, b, atol=1e-12)
            x = [CORNERS, np.asarray(p)]
            for k in np.ndindex(x[i].shape):
                step = np.zeros(x[i].shape)
                step[k] = e
                high, low = (f(*(v + s * step if j == i else v for j, v in enumerate(x))) for s in (1, -1))
                np.testing.assert_allclose(a[(..., *k)], (high - low) / (2 * e), atol=1e-6)


def on_the_triangle():
    a, b, c = CORNERS
    return {"corner": a, "edge": 0.5 * (a + b), "face": (a + b + c) / 3, "other edge": 0.3 * a + 0.7 * c}


@jax.jit
def slopes_in_both_modes(corners, p):
    def f(c, q):
        at, square, _ = look(c, q)
        return jnp.concatenate([at, (Vec3.from_array(q - at).norm() + square)[None]])

    return [jacobian(f, (0, 1))(corners, p) for jacobian in (jax.jacfwd, jax.jacrev)]


@pytest.mark.parametrize("where", on_the_triangle())
@pytest.mark.parametrize("height", [0.0, 0.01])
def test_derivatives_are_finite_on_and_over_every_border(where, height):
    p = jnp.asarray(on_the_triangle()[where] + np.array([0, 0, height]))
    for by_mode in slopes_in_both_modes(CORNERS, p):
        for d in by_mode:
            assert np.isfinite(d).all()
            assert np.abs(d).max() < 1e3


def test_a_triangle_without_area_is_its_edges():
    line = np.array([[0.0, 0, 0], [0.02, 0, 0], [0.01, 0, 0]])
    at, square, feature = look(line, jnp.array([0.005, 0.003, 0.0]))
    np.testing.assert_allclose(at, [0.005, 0, 0], atol=1e-15)
    assert float(square) == pytest.approx(9e-6)
    assert int(feature) in (1, 2, 3)
    spot = np.full((3, 3), 0.01)
    gradient = jax.jit(jax.grad(lambda c: look(c, jnp.zeros(3))[1]))(spot)
    assert np.isfinite(gradient).all()
