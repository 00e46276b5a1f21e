"""Splines fitted to implants: as near as they are asked to come, well-behaved where there is nothing to fit."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import plane_chart

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.geometry.mesh.mesh import load_mesh
from pftwin.geometry.patch.charts import CylindricalChart, PlaneChart
from pftwin.geometry.patch.fit import TOLERANCE, fit_named, fit_patch, fit_spline, name_of, parse_name
from pftwin.geometry.patch.implant import RIG_RIM, rig_implant, rig_region
from pftwin.geometry.patch.region import trochlear_region
from pftwin.geometry.patch.spline import SplinePatch
from pftwin.rig.contacts import contact_fit, implant_mesh

J = jnp.asarray
_DM = {"anterior": (-1, 0, 0), "proximal": (0, 1, 0)}
_WIDE = (-math.radians(80), math.radians(60))  # as in examples/dm_knee.py


def grid(n: int = 41, half: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(-half, half, n), np.linspace(-half, half, n), indexing="ij")
    return u.ravel(), v.ravel()


def wavy(u, v):
    return 1e-3 * np.cos(u / 5e-3) * np.sin(v / 4e-3)


height_of = jax.jit(lambda patch, u, v: patch.height(u, v))


def on_plane(u, v, h) -> np.ndarray:
    return np.stack([u, v, h], 1)


@pytest.fixture(scope="module")
def dm_femur(dm_knee):
    return load_mesh(dm_knee / "femoral_component_contact.stl", units="m")


@pytest.mark.parametrize("chart", ["plane", "cylinder"])
def test_mesh_accuracy_on_the_rigs_implant(chart):
    fit = contact_fit("spline", chart=chart)
    assert fit.rms <= 0.02e-3
    assert fit.rms_normal <= fit.rms
    assert fit.max_error < 0.1e-3
    assert fit.n_vertices == rig_region(implant_mesh(), half_width=RIG_RIM).n_vertices  # all of the trochlea
    assert fit.rms < 0.1 * contact_fit("P5", chart=chart).rms


@pytest.mark.parametrize(
    ("chart", "angles"),
    [("plane", None), ("cylinder", None), ("cylinder", _WIDE)],
    ids=["plane", "cylinder", "as far as the groove goes"],
)
def test_mesh_accuracy_on_the_dm_trochlea(dm_femur, chart, angles):
    limits = {} if angles is None else {"angles": angles}
    region = trochlear_region(dm_femur, **_DM, **limits)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = fit_spline(dm_femur, chart=chart, region=region)
    assert fit.rms <= 0.02e-3
    assert fit.n_vertices == region.n_vertices
    assert fit.max_error < 0.35e-3  # at the mesh's own edge
    assert fit.rms < 0.2 * fit_patch(dm_femur, degree=5, chart=chart, region=region).rms


@pytest.mark.parametrize("chart", ["plane", "cylinder"])
def test_between_the_vertices_it_is_the_smooth_implant(chart):
    """Not only at the vertices: at random places of the surface itself, with its normals."""
    patch, true = contact_fit("spline", chart=chart).patch, rig_implant()
    rng = np.random.default_rng(0)
    u, v = rng.uniform(np.radians(-72), np.radians(28), 500) * 24.8e-3, rng.uniform(-0.019, 0.019, 500)

    @jax.jit
    def compared(u, v):
        jet = true.jet(u, v)
        points = true.chart.point(u, v, jet.f)
        normal = true.chart.axes.apply(true.chart.normal(u, jet.f, jet.u, jet.v))
        q = patch.chart.coordinates(points)
        own = patch.jet(q.x, q.y)
        turned = patch.chart.axes.apply(patch.chart.normal(q.x, own.f, own.u, own.v))
        return (patch.chart.point(q.x, q.y, own.f) - points).dot(normal), turned.dot(normal)

    along, cosine = (np.asarray(a) for a in compared(J(u), J(v)))
    assert np.sqrt(np.mean(along**2)) < 0.02e-3
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 2.0


def test_statistics_are_those_of_the_residuals():
    u, v = grid()
    h = wavy(u, v)
    fit = fit_spline(on_plane(u, v, h), chart=plane_chart())
    assert isinstance(fit.patch, SplinePatch)
    residual = h - np.asarray(height_of(fit.patch, J(u), J(v)))
    assert fit.rms == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-6)
    assert fit.max_error == pytest.approx(np.abs(residual).max(), rel=1e-6)
    assert fit.r_squared == pytest.approx(1 - np.sum(residual**2) / np.sum((h - h.mean()) ** 2), abs=1e-9)
    assert fit.rms <= TOLERANCE
    assert fit.name == "spline"
    assert str(fit).startswith("spline of {} x {} cells: R^2".format(*fit.patch.cells))


def test_residual_along_the_normal_of_a_tilted_plane_is_its_cosine():
    u, v = grid()
    h = 0.75 * u + 1e-5 * np.sign(np.sin(v / 1e-3))
    fit = fit_spline(on_plane(u, v, h), chart=plane_chart(), smoothing=2e-3)
    assert fit.rms_normal == pytest.approx(0.8 * fit.rms, rel=1e-2)


def test_finer_tolerances_take_more_cells():
    u, v = grid(81)
    coarse, fine = (
        fit_spline(on_plane(u, v, wavy(u, v)), chart=plane_chart(), tolerance=t) for t in (0.05e-3, 0.0003e-3)
    )
    sizes = [np.size(fit.patch.coefficients) for fit in (coarse, fine)]
    assert sizes[0] < sizes[1]
    assert fine.rms <= 0.0003e-3


def test_where_there_are_no_vertices_it_goes_on_gently():
    """A corner without vertices, as a trochlea has them beside its notch."""
    u, v = grid()
    keep = (u < 0.008) | (v < 0.008)
    fit = fit_spline(on_plane(u, v, wavy(u, v))[keep], chart=plane_chart())
    assert fit.rms <= TOLERANCE
    corner = np.asarray(height_of(fit.patch, J(u[~keep]), J(v[~keep])))
    assert np.abs(corner).max() < 5e-3
    assert fit.coverage < 1


def test_area_weights_and_emphasis_are_heeded():
    u, v = grid()
    h, part = wavy(u, v) + 2e-4 * np.sign(np.sin(u / 1e-3)), u > 0.01
    points = on_plane(u, v, h)

    def error(emphasis) -> float:
        with pytest.warns(PftwinWarning, match="not within"):
            fit = fit_spline(points, chart=plane_chart(), emphasis=emphasis, smoothing=1e-3)
        return float(np.sqrt(np.mean((np.asarray(height_of(fit.patch, J(u), J(v))) - h)[part] ** 2)))

    assert error(np.where(part, 30.0, 1.0)) < 0.9 * error(None)


def test_an_unreachable_tolerance_warns_and_gives_the_best():
    u, v = grid(21)
    noisy = wavy(u, v) + np.random.default_rng(0).normal(0, 0.2e-3, u.size)
    with pytest.warns(PftwinWarning, match=r"comes within 0\.\d+ mm rms of the 441 vertices, not within 0\.020 mm"):
        fit = fit_spline(on_plane(u, v, noisy), chart=plane_chart())
    assert 0.02e-3 < fit.rms < 0.25e-3


@pytest.mark.parametrize(("chart", "first"), [("plane", "the cylinder as chart, "), ("cylinder", "")])
def test_what_to_try_first_is_the_other_chart(to_the_rim, chart, first):
    mesh, region = to_the_rim
    with pytest.warns(PftwinWarning, match=f"not within 0.000 mm. Try {first}a finer or less noisy mesh"):
        fit_spline(mesh, chart=chart, region=region, tolerance=1e-8)


@pytest.fixture(scope="module")
def to_the_rim():
    mesh = rig_implant().mesh(deviation=0.05e-3)
    return mesh, rig_region(mesh, half_width=RIG_RIM)


def test_a_chart_that_is_not_named_is_the_plane_where_that_holds(to_the_rim):
    mesh, region = to_the_rim
    fit, same = (fit_spline(mesh, region=region, **chart) for chart in ({}, {"chart": "plane"}))
    assert isinstance(fit.patch.chart, PlaneChart)
    np.testing.assert_array_equal(fit.patch.coefficients, same.patch.coefficients)
    assert fit.chart_chosen == ""


def test_where_the_plane_misses_the_tolerance_the_cylinder_is_taken(to_the_rim):
    mesh, region = to_the_rim
    with pytest.warns(PftwinWarning, match="not within"):
        plane = fit_spline(mesh, chart="plane", region=region, tolerance=2e-7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = fit_named(mesh, "spline", region=region, tolerance=2e-7)
    assert isinstance(fit.patch.chart, CylindricalChart)
    assert fit.rms <= 2e-7 < plane.rms
    assert str(fit).endswith(", over the cylinder, as on the plane it comes within 0.00025 mm alone")


def test_where_both_miss_it_the_nearer_is_taken(to_the_rim):
    mesh, region = to_the_rim
    z = region.cylinder.axes.ez
    off = replace(region.cylinder, origin=region.cylinder.origin + z * 0.012)  # far from a trochlear axis
    for given, kind in ((region, CylindricalChart), (replace(region, cylinder=off), PlaneChart)):
        with pytest.warns(PftwinWarning, match="Try a finer or less noisy mesh"):
            fit = fit_spline(mesh, region=given, tolerance=1e-8)
        assert isinstance(fit.patch.chart, kind)
        with pytest.warns(PftwinWarning, match="not within"):
            both = [fit_spline(mesh, chart=c, region=given, tolerance=1e-8).rms for c in ("plane", "cylinder")]
        assert fit.rms == min(both)


def test_where_the_plane_folds_over_the_cylinder_is_taken(dm_femur):
    """From 72 deg distally: over the plane 0.043 mm rms, and 0.8 mm at worst."""
    region = trochlear_region(dm_femur, **_DM, angles=_WIDE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = fit_spline(dm_femur, region=region)
    assert isinstance(fit.patch.chart, CylindricalChart)
    assert fit.rms <= TOLERANCE
    assert fit.max_error < 0.25e-3
    assert re.fullmatch(
        r"over the cylinder, as on the plane the surface folds over at 0\.\d+ % of .*", fit.chart_chosen
    )


def test_a_polynomials_chart_stays_the_plane(to_the_rim):
    mesh, region = to_the_rim
    assert isinstance(fit_named(mesh, "P5", region=region).patch.chart, PlaneChart)


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        (np.zeros((9, 3)), {}, "9 vertices for a spline.*expected: 16 or more"),
        (np.outer(np.arange(20), (1, 2, 3)), {}, "all vertices lie on a line"),
        (np.full((20, 3), np.nan), {}, "20 vertices are not finite"),
        (np.eye(3), {"tolerance": 0}, "tolerance: found 0; expected: a positive length"),
        (np.eye(3), {"smoothing": math.nan}, "smoothing: found nan"),
    ],
)
def test_what_cannot_be_fitted(points, options, message):
    with pytest.raises(InputError, match=message):
        fit_spline(points, chart=plane_chart(), **options)


def test_a_patch_by_its_name():
    u, v = grid()
    points = on_plane(u, v, wavy(u, v))
    assert [parse_name(n) for n in ("p4", 5, " Spline ")] == ["P4", "P5", "spline"]
    for name in ("P4", "spline"):
        fit = fit_named(points, name, chart=plane_chart())
        assert (fit.name, name_of(fit.patch)) == (name, name)
    assert name_of(rig_implant()) is None
    with pytest.raises(InputError, match=r'no polynomial \'splines\'.*or "spline"'):
        parse_name("splines")


def test_the_same_patch_in_single_precision():
    u, v = grid()
    patch = fit_spline(on_plane(u, v, wavy(u, v)), chart=plane_chart()).patch
    small = jax.tree.map(lambda a: J(np.float32(a)), patch)
    with jax.enable_x64(False):
        height = height_of(small, *(J(np.float32(x)) for x in (u, v)))
    assert height.dtype == jnp.float32
    np.testing.assert_allclose(height, wavy(u, v), atol=0.1e-3)
