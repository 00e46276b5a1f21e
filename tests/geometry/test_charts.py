"""Charts: coordinates and points undo each other; tangents, normals and the distance's derivatives are exact."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import patch_of
from scipy.spatial.transform import Rotation as ScipyRotation

from pftwin.base.spatial import Rotation, Vec3
from pftwin.geometry.patch.charts import CylindricalChart, Jet, PlaneChart
from pftwin.geometry.patch.polynomial import exponents

J = jnp.asarray
AXES = ScipyRotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()
ORIGIN = np.array([0.01, -0.02, 0.005])
RADIUS = 0.026
PLANE = PlaneChart(Vec3.from_array(J(ORIGIN)), Rotation.from_array(AXES))
CYLINDER = CylindricalChart(Vec3.from_array(J(ORIGIN)), Rotation.from_array(AXES), J(RADIUS))
CHARTS = pytest.mark.parametrize("chart", [PLANE, CYLINDER], ids=["plane", "cylinder"])
U, V = np.random.default_rng(0).uniform(-0.03, 0.03, (2, 50))


def bumpy(chart):
    """A random P4 over a chart, at heights around the trochlear radius."""
    c = 2e-3 * np.random.default_rng(5).normal(size=len(exponents(4)))
    c[0] += RADIUS
    return patch_of(c, 4, (0.03, 0.03), chart)


@CHARTS
def test_coordinates_and_points_undo_each_other(chart):
    height = RADIUS + 0.1 * U
    point = chart.point(J(U), J(V), J(height))
    np.testing.assert_allclose(chart.coordinates(point).array(), np.stack([U, V, height], 1), atol=1e-15)
    np.testing.assert_allclose(chart.from_frame(chart.to_frame(point)).array(), point.array(), atol=1e-15)


def test_a_cylinder_has_its_height_from_the_axis():
    p = np.asarray(CYLINDER.point(J(U), J(V), J(np.full(50, RADIUS))).array()) - ORIGIN
    from_axis = np.linalg.norm(np.cross(p, AXES[:, 1]), axis=1)
    np.testing.assert_allclose(from_axis, RADIUS, atol=1e-15)
    arc = RADIUS * np.arctan2(p @ AXES[:, 0], p @ AXES[:, 2])
    np.testing.assert_allclose(arc, U, atol=1e-15)


@CHARTS
def test_derivatives_of_half_the_squared_distance(chart):
    surface, c = bumpy(chart), Vec3(J(0.004), J(-0.003), J(RADIUS + 0.015))

    def phi(u, v):
        return 0.5 * (chart.local_point(u, v, surface.height(u, v)) - c).squared_norm()

    @jax.jit
    def both(u, v):
        s = jax.vmap(lambda u, v: chart.separation(c, u, v, surface.jet(u, v)))(u, v)
        return s, jax.vmap(jax.grad(phi, (0, 1)))(u, v), jax.vmap(jax.hessian(phi, (0, 1)))(u, v)

    s, gradient, ((uu, uv), (_, vv)) = both(J(U), J(V))
    for got, expected in zip((*s.gradient, *s.hessian), (*gradient, uu, uv, vv), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-14)


@CHARTS
def test_tangents_gram_and_normal_belong_to_the_surface(chart):
    surface, c = bumpy(chart), Vec3(J(0.0), J(0.0), J(0.05))

    @jax.jit
    def at(u, v):
        def point(u, v):
            return chart.local_point(u, v, surface.height(u, v)).array()

        jet = surface.jet(u, v)
        s = chart.separation(c, u, v, jet)
        tangents = jax.jacfwd(point, (0, 1))(u, v)
        return s, tangents, chart.normal(u, jet.f, jet.u, jet.v).array(), point(u, v)

    s, (tu, tv), normal, point = jax.vmap(at)(J(U), J(V))
    np.testing.assert_allclose(s.tangents[0].array(), tu, atol=1e-12)
    np.testing.assert_allclose(s.tangents[1].array(), tv, atol=1e-12)
    for got, (a, b) in zip(s.gram, ((tu, tu), (tu, tv), (tv, tv)), strict=True):
        np.testing.assert_allclose(got, np.sum(np.asarray(a) * np.asarray(b), 1), atol=1e-12)
    expected = np.cross(tu, tv)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(normal, expected, atol=1e-12)
    out = np.asarray(point) * [1, 0, 1] if chart is CYLINDER else np.array([[0, 0, 1.0]])
    assert np.all(np.sum(np.asarray(normal) * out, axis=1) > 0)


@CHARTS
def test_the_foot_lies_below(chart):
    point = chart.local_point(J(U), J(V), J(np.full(50, 0.04)))
    np.testing.assert_allclose(chart.foot(point), (U, V), atol=1e-15)


def test_slopes_beside_a_place_are_linear():
    jet, du, dv = Jet(*(J(x) for x in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))), 0.1, -0.2
    assert jet.slopes_beside(J(du), J(dv)) == pytest.approx((2 + 4 * du + 5 * dv, 3 + 5 * du + 6 * dv))


def test_a_chart_says_whether_it_goes_round_an_axis():
    assert PLANE.axis_radius is None
    assert CYLINDER.axis_radius == RADIUS
