"""The parametric femoral component: its shape, derivatives, meshes, and how polynomials fit it."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.fit import fit_patch
from pftwin.geometry.patch.implant import FemoralComponent, rig_implant, rig_region
from pftwin.geometry.patch.region import region_about

_DEG = np.pi / 180
_PAPER = {"P2": 91.54, "P4": 99.36, "P5": 99.71}  # R^2 in %, Michaud et al. 2024, section 2.4.2


@pytest.fixture(scope="module")
def fine() -> SurfaceMesh:
    return rig_implant().mesh(deviation=0.006e-3)


LARGEST = 4001


def places(component: FemoralComponent, n: int, seed: int = 0, share: float = 0.98) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    sides = zip(component.center, component.half_size, strict=True)
    u, v = (float(c) + float(h) * rng.uniform(-share, share, n) for c, h in sides)
    return u, v


@eqx.filter_jit
def _height(component, u, v):
    return component.height(u, v)


@eqx.filter_jit
def _jet(component, u, v):
    return component.jet(u, v)


def traced(component: FemoralComponent) -> FemoralComponent:
    """With its parameters as arrays: a program then serves all of them."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=float), component)


def height_of(component, u, v):
    return _padded(_height, component, u, v)


def jet_of(component, u, v):
    return _padded(_jet, component, u, v)


def _padded(function, component, u, v):
    """Of arrays of any shape by one program: filled up to the size of the largest."""
    u, v = np.broadcast_arrays(u, v)
    found = function(traced(component), *(jnp.asarray(np.resize(x, LARGEST)) for x in (u, v)))
    return jax.tree.map(lambda a: np.asarray(a)[: u.size].reshape(u.shape), found)


def test_jet_against_finite_differences():
    c = rig_implant()
    u, v = places(c, 300)
    jet = jet_of(c, u, v)
    e = 1e-6
    np.testing.assert_allclose(jet.f, height_of(c, u, v), rtol=1e-14)
    np.testing.assert_allclose(jet.u, (height_of(c, u + e, v) - height_of(c, u - e, v)) / (2 * e), atol=1e-8)
    np.testing.assert_allclose(jet.v, (height_of(c, u, v + e) - height_of(c, u, v - e)) / (2 * e), atol=1e-8)
    up, down, left, right = (jet_of(c, *at) for at in ((u + e, v), (u - e, v), (u, v - e), (u, v + e)))
    np.testing.assert_allclose(jet.uu, (up.u - down.u) / (2 * e), atol=1e-5)
    np.testing.assert_allclose(jet.uv, (up.v - down.v) / (2 * e), atol=1e-5)
    np.testing.assert_allclose(jet.uv, (right.u - left.u) / (2 * e), atol=1e-5)
    np.testing.assert_allclose(jet.vv, (right.v - left.v) / (2 * e), atol=1e-5)


def test_second_derivatives_have_no_jumps():
    c = rig_implant()
    (u0, v0), (half_u, half_v) = c.center, c.half_size
    t = np.linspace(-1, 1, LARGEST)
    lines = (u0 + half_u * t, 0.009), (-0.01, v0 + half_v * t)
    for jet in (jet_of(c, *line) for line in lines):
        for name in ("uu", "uv", "vv"):
            values = np.asarray(getattr(jet, name))
            assert np.abs(np.diff(values)).max() < 0.02 * max(np.ptp(values), 1.0)


def test_derivatives_with_respect_to_every_parameter_are_finite_and_true():
    c = traced(rig_implant())
    u, v = places(c, 40)

    @jax.jit
    @jax.value_and_grad
    def total(component: FemoralComponent) -> jax.Array:
        jet = component.jet(u, v)
        return jnp.sum(jet.f * (1 + u / 0.02)) + jnp.sum(jet.uv)

    _, gradient = total(c)
    for field in dataclasses.fields(c):
        if field.name in ("proximal_end", "distal_end", "half_width"):
            continue
        exact, value = float(getattr(gradient, field.name)), getattr(c, field.name)
        e = 1e-5 * max(abs(float(value)), 1e-3)
        high, low = (total(eqx.tree_at(lambda t, n=field.name: getattr(t, n), c, value + s * e))[0] for s in (1, -1))
        assert exact != 0, field.name
        assert exact == pytest.approx(float(high - low) / (2 * e), rel=1e-4, abs=1e-6), field.name


def test_the_groove_is_what_its_parameters_say():
    c = FemoralComponent(lateral_steepness=0.0, groove_obliquity=0.0, notch_depth=0.0)
    u = -20 * _DEG * c.trochlear_radius  # far from flange and distal arc
    bottom = jet_of(c, u, 0.0)
    assert float(bottom.f) == pytest.approx(c.trochlear_radius, abs=0.3e-3)
    assert float(bottom.v) == pytest.approx(0, abs=1e-12)
    assert 1 / float(bottom.vv) == pytest.approx(c.groove_radius, rel=5e-3)
    far = dataclasses.replace(c, facet_width=0.5, flange_angle=3.0, distal_angle=-3.0, sulcus_transition=3.0)
    slope = float(jet_of(far, u, 0.2).v)
    assert 2 * np.arctan(1 / slope) == pytest.approx(c.sulcus_angle, rel=1e-3)


def test_the_sagittal_arcs_are_circles_of_the_stated_radii():
    c = FemoralComponent(sagittal_blend=0.5 * _DEG, notch_depth=0.0, groove_obliquity=0.0)
    for angle, radius in ((-15, c.trochlear_radius), (35, c.flange_radius), (-85, c.distal_radius)):
        t = (angle + np.array([-4.0, 0.0, 4.0])) * _DEG
        r = height_of(c, t * c.trochlear_radius, 0.0)
        x, z = r * np.sin(t), r * np.cos(t)
        sides = [np.hypot(x[i] - x[j], z[i] - z[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
        area = 0.5 * abs((x[1] - x[0]) * (z[2] - z[0]) - (x[2] - x[0]) * (z[1] - z[0]))
        assert np.prod(sides) / (4 * area) == pytest.approx(radius, rel=0.01), angle


def test_anatomy_of_the_rig_implant():
    c = rig_implant()
    assert c.groove_radius < 18e-3  # narrower than a button's 20 to 25 mm: it rides on two facets at once
    v = np.linspace(-0.025, 0.025, 501)

    def facets(angle: float) -> tuple[float, float]:
        h = height_of(c, angle * _DEG * c.trochlear_radius, v)
        valley = 150 + int(np.argmin(h[150:350]))
        return h[valley:].max() - h[valley], h[:valley].max() - h[valley]

    lateral, medial = facets(-40)
    assert lateral > medial > 2e-3
    assert sum(facets(25)) < sum(facets(-40)) < sum(facets(-75))  # shallow on the flange, deepening to the notch
    assert float(c.groove_line(0.01)) > 0


def test_a_sphere_rests_on_two_facets():
    c = rig_implant()
    radius, angle = 25e-3, -30 * _DEG
    v = np.linspace(-0.016, 0.016, 1601)
    u = np.full_like(v, angle * c.trochlear_radius)
    h = height_of(c, u, v)
    y = np.linspace(-0.008, 0.008, 801)
    above = np.max(h + np.sqrt(radius**2 - (v - y[:, None]) ** 2), axis=1)  # height of the center that just touches
    rest = int(np.argmin(above))
    gap = np.hypot(above[rest] - h, v - y[rest]) - radius
    touching = v[gap < 5e-6]
    assert gap[np.argmin(np.abs(v - y[rest]))] > 0.1e-3
    assert touching.min() < y[rest] - 4e-3
    assert touching.max() > y[rest] + 4e-3


def test_outside_measures_the_way_past_the_edge():
    c = rig_implant()
    (u0, v0), (half_u, half_v) = c.center, c.half_size
    assert float(c.outside(u0, v0)) == 0
    assert float(c.outside(u0 + half_u + 0.002, v0)) == pytest.approx(0.002)
    assert float(c.outside(u0, v0 - half_v - 0.003)) == pytest.approx(0.003)
    assert np.isfinite(jet_of(c, float(u0) + float(half_u) + 0.01, float(v0) + float(half_v) + 0.02)).all()


@pytest.mark.parametrize("deviation", [0.1e-3, 0.006e-3])
@pytest.mark.slow
def test_the_mesh_stays_within_its_deviation(deviation):
    c = rig_implant()
    mesh = c.mesh(deviation=deviation)
    assert not mesh.is_closed
    assert (np.diff(np.sort(mesh.faces, axis=1), axis=1) > 0).all()
    rng = np.random.default_rng(0)
    share = rng.dirichlet(np.ones(3), len(mesh.faces))
    points = np.einsum("ij,ijk->ik", share, mesh.vertices[mesh.faces])
    u, v, height = (np.asarray(x) for x in dataclasses.astuple(_coordinates(c, points)))
    jet = c.jet(jnp.asarray(u), jnp.asarray(v))
    around = np.asarray(jet.u) * c.trochlear_radius / np.asarray(jet.f)
    distance = np.abs(height - np.asarray(jet.f)) / np.sqrt(1 + around**2 + np.asarray(jet.v) ** 2)
    assert distance.max() <= 1.02 * deviation
    assert distance.max() > 0.2 * deviation  # no finer than asked for
    up = mesh.vertex_normals[:, 0] * mesh.vertices[:, 0] + mesh.vertex_normals[:, 2] * mesh.vertices[:, 2]
    assert (up > 0).all()


def _coordinates(component: FemoralComponent, points: np.ndarray):
    from pftwin.base.spatial import Vec3

    return component.chart.coordinates(Vec3.from_array(points))


@pytest.mark.slow
def test_the_angle_bound_holds_along_the_grid():
    mesh = rig_implant().mesh(deviation=0.1e-3, angle=4 * _DEG)
    normals = mesh.area_vectors / mesh.face_areas[:, None]
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    order = np.lexsort(edges.T)
    same = np.flatnonzero((edges[order][1:] == edges[order][:-1]).all(axis=1))
    a, b = order[same] % len(normals), order[same + 1] % len(normals)
    turn = np.arccos(np.clip(np.einsum("ij,ij->i", normals[a], normals[b]), -1, 1))
    assert np.quantile(turn, 0.99) < 4.2 * _DEG
    assert len(mesh.faces) > 2 * len(rig_implant().mesh(deviation=0.1e-3).faces)


def tuned_region(mesh):
    """The region over which the component was tuned to have the paper's R^2."""
    return region_about(mesh, rig_implant().chart, angles=(-75 * _DEG, 30 * _DEG), half_width=20e-3)


@pytest.mark.parametrize("name", ["P2", "P4", "P5"])
def test_polynomials_fit_the_rig_implant_as_well_as_the_papers(fine, name):
    fit = fit_patch(fine, degree=name, chart="plane", region=tuned_region(fine))
    assert 100 * fit.r_squared == pytest.approx(_PAPER[name], abs=0.2)
    assert fit.coverage == 1


def test_errors_fall_with_the_degree_and_on_a_cylinder(fine):
    region = tuned_region(fine)
    rms = {
        chart: [fit_patch(fine, degree=d, chart=chart, region=region).rms for d in (2, 4, 5, 8)]
        for chart in ("plane", "cylinder")
    }
    expected = {"plane": [0.93e-3, 0.26e-3, 0.18e-3, 0.07e-3], "cylinder": [0.80e-3, 0.17e-3, 0.09e-3, 0.03e-3]}
    for chart, values in rms.items():
        np.testing.assert_allclose(values, expected[chart], rtol=0.15)


def test_the_coarse_mesh_gives_nearly_the_same_patch(fine):
    coarse = rig_implant().mesh()
    a, b = (
        fit_patch(mesh, degree="P5", chart="plane", region=rig_region(mesh), weights="area") for mesh in (coarse, fine)
    )
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(-0.015, 0.015, 20), np.linspace(-0.018, 0.018, 20)))
    heights = [np.asarray(_height(fit.patch, u, v)) for fit in (a, b)]
    assert np.abs(heights[0] - heights[1]).max() < 0.2e-3
    assert len(fine.faces) > 10 * len(coarse.faces)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("trochlear_radius", -0.02),
        ("sulcus_angle", 200 * _DEG),
        ("groove_radius", 0.0),
        ("notch_depth", float("nan")),
        ("distal_end", 60 * _DEG),
    ],
)
def test_parameters_that_make_no_component(field, value):
    with pytest.raises(InputError, match=f"FemoralComponent.{field}"):
        FemoralComponent(**{field: value}).mesh()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"deviation": 0.0}, "expected: a positive length"),
        ({"deviation": 1e-9}, "expected: at most 2000000"),
        ({"angle": 2.0}, "between 0 and pi/2"),
    ],
)
def test_mesh_tolerances_that_cannot_be(arguments, message):
    with pytest.raises(InputError, match=message):
        rig_implant().mesh(**arguments)
