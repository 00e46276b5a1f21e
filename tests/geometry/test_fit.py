"""Fits: known polynomials come back, R^2 means what it says, and what cannot be fitted is refused."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.spatial import Rotation, Vec3
from pftwin.geometry.mesh.mesh import check_mesh
from pftwin.geometry.patch.charts import CylindricalChart, PlaneChart
from pftwin.geometry.patch.fit import fit_patch, parse_degree

_TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
_ORIGIN = np.array([0.1, -0.2, 0.3])


def plane(turn: np.ndarray = _TURN, origin: np.ndarray = _ORIGIN) -> PlaneChart:
    return PlaneChart(Vec3.from_array(origin), Rotation.from_array(turn))


def cylinder(radius: float = 0.026) -> CylindricalChart:
    return CylindricalChart(Vec3.from_array(_ORIGIN), Rotation.from_array(_TURN), jnp.asarray(radius))


def grid(n: int = 25, half_u: float = 0.022, half_v: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(-half_u, half_u, n), np.linspace(-half_v, half_v, n), indexing="ij")
    return u.ravel(), v.ravel()


def on(chart, u, v, h) -> np.ndarray:
    return np.asarray(chart.point(jnp.asarray(u), jnp.asarray(v), jnp.asarray(h)).array())


def polynomial(u, v, degree: int, seed: int = 0) -> np.ndarray:
    """Some polynomial of total degree `degree` with heights of millimetres around 26 mm."""
    rng = np.random.default_rng(seed)
    terms = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return 0.026 + sum(1e-3 * rng.normal() * (u / 0.02) ** i * (v / 0.02) ** j for i, j in terms)


def gridded_mesh(points: np.ndarray, n: int):
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return check_mesh(points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


@pytest.mark.parametrize("degree", [1, 2, 4, 5, 8])
@pytest.mark.parametrize("make", [plane, cylinder])
def test_a_polynomial_comes_back(degree, make):
    chart = make()
    u, v = grid()
    h = polynomial(u, v, degree)
    fit = fit_patch(on(chart, u, v, h), degree=f"P{degree}", chart=chart)
    assert fit.name == f"P{degree}"
    assert fit.max_error < 1e-12
    assert fit.r_squared == pytest.approx(1, abs=1e-12)
    assert fit.n_vertices == len(u)
    between = np.random.default_rng(1).uniform(-0.019, 0.019, (2, 50))
    np.testing.assert_allclose(fit.patch.height(*jnp.asarray(between)), polynomial(*between, degree), atol=1e-11)


def test_r_squared_rms_and_maximum_error_are_those_of_the_residuals():
    u, v = grid()
    h = polynomial(u, v, 2) + 2e-4 * np.sin(u / 3e-3)
    fit = fit_patch(on(plane(), u, v, h), degree=2, chart=plane())
    residual = h - np.asarray(fit.patch.height(jnp.asarray(u), jnp.asarray(v)))
    assert fit.r_squared == pytest.approx(1 - np.sum(residual**2) / np.sum((h - h.mean()) ** 2), rel=1e-9)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(residual**2)))
    assert fit.max_error == pytest.approx(np.abs(residual).max())
    assert 0 < fit.rms_normal < fit.rms
    assert "P2: R^2" in str(fit)


def test_residual_along_the_normal_of_a_tilted_plane_is_its_cosine():
    u, v = grid()
    h = 0.75 * u + 1e-4 * np.sign(np.sin(v / 1e-3))
    fit = fit_patch(on(plane(), u, v, h), degree=1, chart=plane())
    assert fit.rms_normal == pytest.approx(0.8 * fit.rms, rel=1e-3)


def test_a_circle_over_a_cylinder_is_a_constant():
    u, v = grid()
    fit = fit_patch(on(cylinder(), u, v, np.full_like(u, 0.026)), degree=2, chart=cylinder())
    np.testing.assert_allclose(fit.patch.coefficients, [0.026, 0, 0, 0, 0, 0], atol=1e-15)


def test_emphasis_improves_the_fit_where_it_is_laid():
    u, v = grid()
    h = 2e-3 * np.cos(v / 6e-3) * (1 + u / 0.02)
    points, part = on(plane(), u, v, h), u > 0.01

    def error(fit) -> float:
        e = np.asarray(fit.patch.height(jnp.asarray(u), jnp.asarray(v))) - h
        return float(np.sqrt(np.mean(e[part] ** 2)))

    even = fit_patch(points, degree=2, chart=plane())
    by_array = fit_patch(points, degree=2, chart=plane(), emphasis=np.where(part, 30.0, 1.0))
    by_function = fit_patch(
        points, degree=2, chart=plane(), emphasis=lambda p: np.where(((p - _ORIGIN) @ _TURN)[:, 0] > 0.01, 30.0, 1.0)
    )
    assert error(by_array) < 0.8 * error(even)
    np.testing.assert_allclose(by_array.patch.coefficients, by_function.patch.coefficients, rtol=1e-12)


def test_area_weights_undo_an_uneven_mesh():
    def fitted(n: int, power: float, weights):
        t = np.linspace(-1, 1, n)
        s = 0.02 * np.sign(t) * np.abs(t) ** power
        u, v = (g.ravel() for g in np.meshgrid(s, s, indexing="ij"))
        mesh = gridded_mesh(on(plane(), u, v, 1e-3 * np.cos(u / 5e-3) + 2e-4 * (u / 0.02) ** 3), n)
        return np.asarray(fit_patch(mesh, degree=2, chart=plane(), weights=weights).patch.coefficients)

    even = fitted(61, 1.0, "area")
    assert np.abs(fitted(61, 2.0, "area") - even).max() < 2e-5
    assert np.abs(fitted(61, 2.0, "vertex") - even).max() > 1e-4


def test_a_mask_chooses_the_vertices():
    u, v = grid()
    h = np.where(u > 0, 0.5, 0.0)
    fit = fit_patch(on(plane(), u, v, h), degree=1, chart=plane(), region=u <= 0)
    assert fit.n_vertices == int((u <= 0).sum())
    assert fit.max_error < 1e-14
    assert float(fit.patch.center[0]) == pytest.approx(-0.011)


@pytest.mark.parametrize(
    ("name", "degree"), [("P5", 5), ("p2", 2), (4, 4), ("12", 12), pytest.param(" P3 ", 3, id="blanks")]
)
def test_degree_by_name(name, degree):
    assert parse_degree(name) == degree


@pytest.mark.parametrize("name", ["P0", "Q5", "", "P13", -1, 2.5, True])
def test_degrees_that_are_none(name):
    with pytest.raises(InputError, match='expected: "P1" to "P12"'):
        parse_degree(name)


def test_too_few_vertices():
    u, v = grid(4)
    with pytest.raises(InputError, match="16 vertices for the 21 coefficients of P5"):
        fit_patch(on(plane(), u, v, 0 * u), degree="P5", chart=plane())


def test_vertices_along_lines_do_not_determine_the_coefficients():
    u, v = np.meshgrid(np.linspace(-0.02, 0.02, 40), [-0.02, 0.0, 0.02])
    with pytest.raises(InputError, match="determine only 15 of the 21 coefficients of P5"):
        fit_patch(on(plane(), u.ravel(), v.ravel(), 0 * u.ravel()), degree=5, chart=plane())


def test_values_that_are_not_finite():
    u, v = grid()
    points = on(plane(), u, v, 0 * u).copy()
    points[7] = np.nan
    with pytest.raises(InputError, match="1 vertices are not finite, the first is number 7"):
        fit_patch(points, chart=plane())
    with pytest.raises(InputError, match=r"shape \(4,\).*\(n, 3\)"):
        fit_patch(np.zeros(4), chart=plane())


def test_a_surface_folded_over_is_refused_and_fits_on_a_cylinder():
    n = 41
    u, v = grid(n, half_u=0.026 * np.radians(110))
    mesh = gridded_mesh(on(cylinder(), u, v, np.full_like(u, 0.026)), n)
    with pytest.raises(InputError, match=r"% of the vertices face away from the chart.*cylinder"):
        fit_patch(mesh, degree=4, chart=plane())
    assert fit_patch(mesh, degree=4, chart=cylinder()).max_error < 1e-12
    with pytest.raises(InputError, match="point into the bone"):
        fit_patch(mesh.flipped(), degree=4, chart=cylinder())


def test_a_few_folded_vertices_warn():
    n = 41
    u, v = grid(n)
    h = np.where((u > 0.0195) & (np.abs(v) < 0.004), -0.01, 0.0)
    mesh = gridded_mesh(on(plane(), u, v, h) - np.outer((h < 0) * 4e-3, _TURN[:, 0]), n)
    with pytest.warns(PftwinWarning, match="folds over"):
        fit_patch(mesh, degree=4, chart=plane())


def test_a_patch_without_vertices_in_its_middle_warns():
    u, v = grid()
    keep = np.maximum(np.abs(u), np.abs(v)) > 0.015
    with pytest.warns(PftwinWarning, match="vertices cover .* of the patch's rectangle"):
        fit_patch(on(plane(), u, v, 0 * u)[keep], degree=3, chart=plane())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"chart": "plane"}, r"chart='plane' has no position.*trochlear_region"),
        ({"chart": "sphere"}, "no chart 'sphere'"),
        ({"chart": plane(), "weights": "area"}, "vertices alone have no areas"),
        ({"chart": plane(), "weights": "even"}, "no weights 'even'"),
        ({"chart": plane(), "emphasis": np.ones(3)}, r"weights of shape \(3,\)"),
        ({"chart": plane(), "emphasis": lambda p: -np.ones(len(p))}, "none negative"),
        ({"chart": plane(), "emphasis": lambda p: np.zeros(len(p))}, "all weights are zero"),
        ({"chart": plane(), "region": np.ones(5, dtype=bool)}, r"shape \(5,\) for 625 vertices"),
        ({"chart": plane(), "region": np.zeros(625, dtype=bool)}, "0 vertices for the 21 coefficients"),
        ({"chart": plane(), "degree": "P99"}, "no polynomial 'P99'"),
    ],
)
def test_bad_arguments(arguments, message):
    u, v = grid()
    with pytest.raises(InputError, match=message):
        fit_patch(on(plane(), u, v, 0 * u), **arguments)
