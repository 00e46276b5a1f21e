"""Spline patches: bicubics reproduced, C2 across knots, C1 past the edge, derivatives, closest points, facets."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, contact, look, plane_chart, vec

from pftwin.base.spatial import Vec3
from pftwin.geometry.contact.facets import follow_facets
from pftwin.geometry.patch.closest import Surface
from pftwin.geometry.patch.fit import fit_spline
from pftwin.geometry.patch.spline import SplinePatch, cubic_basis
from pftwin.model.effects.contact_law import Hertz

J = jnp.asarray
HALF = (0.024, 0.02)
CENTER = (0.003, -0.001)
CELLS = (5, 7)


def random_spline(cells=CELLS, seed: int = 0) -> SplinePatch:
    c = 1e-3 * np.random.default_rng(seed).normal(size=(cells[0] + 3, cells[1] + 3))
    return SplinePatch(plane_chart(), J(c), (J(CENTER[0]), J(CENTER[1])), (J(HALF[0]), J(HALF[1])))


N = 200  # places at once, everywhere: one program each for heights and jets serves all tests


def places(reach: float) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.random.default_rng(1).uniform(-reach, reach, (2, N))
    return CENTER[0] + HALF[0] * a, CENTER[1] + HALF[1] * b


@eqx.filter_jit
def height_of(patch, u, v):
    return patch.height(u, v)


outside = eqx.filter_jit(lambda patch, u, v: patch.outside(u, v))


@eqx.filter_jit
def jet_of(patch, u, v):
    return patch.jet(u, v)


@eqx.filter_jit
def automatic(patch, u, v):
    """The height's slopes and second derivatives by JAX, in the order of a jet."""
    first = jax.vmap(jax.grad(patch.height, (0, 1)))(u, v)
    (uu, uv), (_, vv) = jax.vmap(jax.hessian(patch.height, (0, 1)))(u, v)
    return *first, uu, uv, vv


def groove(u, v):
    """Narrower than the button, round in front: two facets."""
    return 0.026 - 6 * u**2 + np.tan(np.radians(25)) * np.sqrt(v**2 + 0.005**2)


def grooved(half=0.02) -> SplinePatch:
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(-0.024, 0.024, 61), np.linspace(-half, half, 61)))
    return fit_spline(np.stack([u, v, groove(u, v)], 1), chart=plane_chart()).patch  # type: ignore[return-value]


@pytest.fixture(scope="module")
def trochlea() -> SplinePatch:
    return grooved()


def test_the_basis_is_a_partition_of_unity_and_its_derivatives_are_derivatives():
    x, h = np.linspace(0, 1, 21), 1e-6
    values, slopes = cubic_basis(x)
    np.testing.assert_allclose(sum(values), 1, atol=1e-15)
    np.testing.assert_allclose(sum(slopes), 0, atol=1e-15)
    after, before = cubic_basis(x + h)[0], cubic_basis(x - h)[0]
    for k in range(4):
        np.testing.assert_allclose(slopes[k], (after[k] - before[k]) / (2 * h), atol=1e-9)


def test_the_patch_is_scipys_spline():
    from scipy.interpolate import NdBSpline

    patch, (u, v) = random_spline(), places(0.999)
    knots = tuple(m + h * (np.arange(-3, n + 4) * 2 / n - 1) for m, h, n in zip(CENTER, HALF, CELLS, strict=True))
    theirs = NdBSpline(knots, np.asarray(patch.coefficients), 3)
    jet, points = jet_of(patch, J(u), J(v)), np.stack([u, v], 1)
    orders = {"f": (0, 0), "u": (1, 0), "v": (0, 1), "uu": (2, 0), "uv": (1, 1), "vv": (0, 2)}
    for name, order in orders.items():
        expected = theirs(points, nu=order)
        np.testing.assert_allclose(getattr(jet, name), expected, atol=1e-12 * np.abs(expected).max())


def test_a_bicubic_is_reproduced():
    square = np.random.default_rng(3).normal(size=(4, 4))
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(-0.02, 0.02, 30), np.linspace(-0.02, 0.02, 30)))

    def bicubic(u, v):
        return 1e-3 * np.polynomial.polynomial.polyval2d(u / 0.02, v / 0.02, square)

    fit = fit_spline(np.stack([u, v, bicubic(u, v)], 1), chart=plane_chart(), smoothing=1e-6, tolerance=1e-9)
    between = np.random.default_rng(4).uniform(-0.02, 0.02, (2, 100))
    np.testing.assert_allclose(height_of(fit.patch, *map(J, between)), bicubic(*between), atol=1e-11)


@pytest.mark.parametrize("order", ["f", "u", "v", "uu", "uv", "vv"])
def test_value_slope_and_curvature_have_no_jump_at_a_knot(order):
    patch = random_spline()

    def jet(u, v):
        return getattr(jet_of(patch, u, v), order)

    knots_u = CENTER[0] + HALF[0] * (np.arange(1, CELLS[0]) * 2 / CELLS[0] - 1)
    knots_v = CENTER[1] + HALF[1] * (np.arange(1, CELLS[1]) * 2 / CELLS[1] - 1)
    u, v = places(0.99)
    size = np.abs(np.asarray(jet(J(u), J(v)))).max()
    for knot in knots_u:
        sides = [np.asarray(jet(J(np.full_like(v, knot + e)), J(v))) for e in (-1e-12, 1e-12)]
        np.testing.assert_allclose(sides[0], sides[1], atol=1e-7 * size)
    for knot in knots_v:
        sides = [np.asarray(jet(J(u), J(np.full_like(u, knot + e)))) for e in (-1e-12, 1e-12)]
        np.testing.assert_allclose(sides[0], sides[1], atol=1e-7 * size)


def test_jet_against_automatic_and_finite_differences():
    patch, (u, v) = random_spline(), places(0.98)
    jet = jet_of(patch, J(u), J(v))
    for closed_form, derivative in zip(jet[1:], automatic(patch, J(u), J(v)), strict=True):
        np.testing.assert_allclose(closed_form, derivative, rtol=1e-9, atol=1e-11)
    h = 1e-7
    across = (jet_of(patch, J(u), J(v + h)), jet_of(patch, J(u), J(v - h)))
    for name, derivative in (("f", "v"), ("u", "uv"), ("v", "vv")):
        difference = (getattr(across[0], name) - getattr(across[1], name)) / (2 * h)
        np.testing.assert_allclose(getattr(jet, derivative), difference, rtol=1e-4, atol=2e-3)


def test_beyond_the_edge_slopes_and_curvatures_belong_to_the_height():
    patch, (u, v) = random_spline(), (J(x) for x in places(3.0))
    beyond = np.asarray(outside(patch, u, v)) > 0
    assert 20 < beyond.sum() < N
    for own, derivative, atol in zip(
        jet_of(patch, u, v)[1:], automatic(patch, u, v), (1e-12, 1e-12, 1e-9, 1e-9, 1e-9), strict=True
    ):
        np.testing.assert_allclose(own, derivative, rtol=1e-9, atol=atol)


def test_value_and_slope_are_continuous_across_the_edge():
    patch, along = random_spline(), np.linspace(-1.5, 1.5, N)  # past the corners as well
    for side in (-1, 1):
        for across_u in (True, False):
            edge = []
            for offset in (-1e-10, 1e-10):
                s = np.full_like(along, side + offset)
                a, b = (s, along) if across_u else (along, s)
                edge.append(jet_of(patch, J(CENTER[0] + HALF[0] * a), J(CENTER[1] + HALF[1] * b)))
            for name, tolerance in (("f", 1e-11), ("u", 1e-7), ("v", 1e-7)):
                np.testing.assert_allclose(getattr(edge[0], name), getattr(edge[1], name), atol=tolerance)


def test_it_goes_on_straight_and_says_how_far_out():
    patch = random_spline()
    out = np.linspace(1, 50, N)
    height = np.asarray(height_of(patch, J(CENTER[0] + HALF[0] * out), J(np.full(N, CENTER[1]))))
    np.testing.assert_allclose(np.diff(height, 2), 0, atol=1e-15 + 1e-12 * np.ptp(height))
    u = CENTER[0] + np.array([0, 0.024, 0.025, -0.030, 0.0, 0.026])
    v = CENTER[1] + np.array([0, -0.02, 0.0, 0.0, -0.023, 0.025])
    np.testing.assert_allclose(outside(patch, J(u), J(v)), [0, 0, 0.001, 0.006, 0.003, 0.005], atol=1e-12)


def test_the_form_for_a_loop_says_the_same():
    patch = random_spline()
    ready = patch.unstacked()
    assert ready.unstacked() is ready
    u, v = (J(x) for x in places(1.5))
    np.testing.assert_array_equal(height_of(patch, u, v), height_of(ready, u, v))
    np.testing.assert_array_equal(patch.clipped(v), ready.clipped(v))


def test_places_that_are_not_finite_give_no_number():
    assert np.isnan(height_of(random_spline(), J(np.full(N, np.nan)), J(np.zeros(N)))).all()


def test_the_fans_polynomial_is_the_nearest_one():
    patch, n = random_spline((4, 3)), 60
    nodes, weights = np.polynomial.legendre.leggauss(n)
    a, b = (g.ravel() for g in np.meshgrid(nodes, nodes, indexing="ij"))
    weight = np.sqrt(np.outer(weights, weights).ravel())
    heights = np.asarray(height_of(patch, J(CENTER[0] + HALF[0] * a), J(CENTER[1] + HALF[1] * b)))
    basis = np.stack([a**i * b**j for j in range(5) for i in range(5 - j)], 1)
    expected = np.linalg.lstsq(basis * weight[:, None], heights * weight, rcond=None)[0]
    # Quadrature across knots is good to some 1e-5 of the heights.
    found = eqx.filter_jit(lambda p: J(p.nearest_polynomial(4).coefficients))(patch)
    np.testing.assert_allclose(found, expected, atol=2e-6)


def found(button, p: Vec3):
    """Both points as a scene finds them from nothing: distances, places across the groove."""
    at = eqx.tree_at(lambda n: n.patella.position, look((0, 0, 0)), p)
    facets = follow_facets(button.surface, p, button.radius, button.remember(at).places)
    return jnp.stack([facets.medial.distance, facets.lateral.distance]), jnp.stack([facets.medial.v, facets.lateral.v])


ALONG, ACROSS = J(np.linspace(-0.006, 0.006, 61)), J(np.linspace(-0.0195, 0.0195, 391))


def distances(patch: Surface, p: Vec3):
    """Brute force: the least distance at each place across the groove."""
    u, v = jnp.meshgrid(p.x + ALONG, ACROSS, indexing="ij")
    gap = Vec3(u, v, patch.height(u, v)) - Vec3(*(jnp.broadcast_to(x, u.shape) for x in (p.x, p.y, p.z)))
    return gap.norm().min(axis=0)


def test_the_facets_of_a_brute_force_search_are_found(trochlea):
    """With the button 20 um deep in the nearer facet, whoever else is within 0.1 mm of touching: none is missed."""
    n, rng = 60, np.random.default_rng(5)
    u, y = J(rng.uniform(-0.018, 0.018, n)), J(rng.uniform(-0.0004, 0.0004, n))
    button = contact(Hertz(J(2e8)), trochlea).recentred(vec(0, 0, 0))

    @jax.jit
    @jax.vmap
    def lowered(u, y):
        def lower(_, z):
            return z - (jnp.min(distances(button.surface, Vec3(u, y, z))) - RADIUS + 2e-5)

        z = jax.lax.fori_loop(0, 12, lower, button.surface.height(u, y) + RADIUS + 0.01)
        p = Vec3(u, y, z)
        return distances(button.surface, p), *found(button, p)

    brute, near, v = (np.asarray(a) for a in lowered(u, y))
    minima = (brute[:, 1:-1] < brute[:, :-2]) & (brute[:, 1:-1] <= brute[:, 2:]) & (brute[:, 1:-1] < RADIUS + 1e-4)
    both = 0
    for k in range(n):
        places = np.flatnonzero(minima[k]) + 1
        both += len(places) == 2
        for i in places:
            nearest = np.argmin(np.abs(v[k] - float(ACROSS[i])))
            assert abs(v[k, nearest] - float(ACROSS[i])) < 3e-4
            assert near[k, nearest] == pytest.approx(brute[k, i], abs=2e-6)  # the grid's own error
    assert both > 15


@pytest.mark.parametrize(
    "place",
    [
        (0.004, 0.001, -1e-4),
        *(pytest.param(p, marks=pytest.mark.slow) for p in ((0.004, 0.001, 2e-3), (0.0262, 0.002, -1e-4))),
    ],
    ids=["touch", "apart", "beyond the edge"],
)
@pytest.mark.slow
def test_derivatives_by_coefficients_are_those_of_finite_differences(trochlea, place):
    """Of the distances at the closest points, forward and in reverse."""
    u, y, gap = place
    law = Hertz(J(2e8))
    button = contact(law, trochlea).recentred(vec(0, 0, 0))
    high = groove(u, y) + RADIUS + 0.01
    nearest_first = jax.jit(lambda z: jnp.min(found(button, Vec3(J(u), J(y), z))[0]))
    for _ in range(20):
        high = high - (float(nearest_first(J(high))) - RADIUS - gap)

    def nearest(coefficients):
        surface = eqx.tree_at(lambda s: s.coefficients, trochlea, coefficients)
        return jnp.min(found(contact(law, surface).recentred(vec(0, 0, 0)), Vec3(J(u), J(y), J(high)))[0])

    reverse, forward = (np.asarray(jax.jit(f(nearest))(trochlea.coefficients)) for f in (jax.grad, jax.jacfwd))
    np.testing.assert_allclose(forward, reverse, atol=1e-12)
    assert np.isfinite(reverse).all()
    largest = np.argsort(-np.abs(reverse).ravel())[:3]
    value = jax.jit(nearest)
    for k in largest:
        bump = np.zeros(reverse.size)
        bump[k] = 1e-7
        step = J(bump.reshape(reverse.shape))
        difference = (value(trochlea.coefficients + step) - value(trochlea.coefficients - step)) / 2e-7
        assert reverse.ravel()[k] == pytest.approx(float(difference), rel=1e-3)


def test_a_batch_of_coefficients_is_each_of_them():
    many = [random_spline(seed=s) for s in range(3)]
    u, v = (J(x) for x in places(1.2))
    stacked = jnp.stack([p.coefficients for p in many])

    @jax.jit
    @jax.vmap
    def together(c):
        return eqx.tree_at(lambda s: s.coefficients, many[0], c).unstacked().height(u, v)

    np.testing.assert_allclose(together(stacked), [height_of(p, u, v) for p in many], rtol=1e-13, atol=1e-17)


def gathers(jaxpr):
    """The shape of what is fetched at once by each gather of a program, and whether its places are put together."""
    joined = {v for e in jaxpr.eqns if e.primitive.name == "concatenate" for v in e.outvars}
    for e in jaxpr.eqns:
        if e.primitive.name == "gather":
            yield e.params["slice_sizes"], e.invars[1] in joined
        for inner in (getattr(x, "jaxpr", None) for x in e.params.values()):
            if inner is not None:
                yield from gathers(inner)


def test_a_batch_of_surfaces_loads_the_cells_numbers_one_by_one():
    """Whole rows fused into what follows are computed again for every number of theirs: 16 times for each jet that
    starts where another has led, and XLA compiled two of them in a row for minutes."""
    stacked = jnp.stack([random_spline(seed=s).coefficients for s in range(3)])

    def curved(c):
        patch = eqx.tree_at(lambda s: s.coefficients, random_spline(), c).unstacked()
        return patch.jet(J(0.001), J(0.002)).uv

    found = list(gathers(jax.make_jaxpr(jax.vmap(curved))(stacked).jaxpr))
    assert len(found) == 16
    assert all(sizes == (1,) and not joined for sizes, joined in found)


def test_waves_are_a_legendre_series_over_the_rectangle():
    """Exactly to degree three; cubics through four places h apart leave 9/16 h^4 of x^4, and P_4 has 35/8 of it."""
    patch = random_spline()
    a, b = np.random.default_rng(7).uniform(-1, 1, (2, N))
    u, v = J(CENTER[0] + HALF[0] * a), J(CENTER[1] + HALF[1] * b)
    for degree in (3, 4):
        series = np.random.default_rng(6).normal(size=(degree + 1, degree + 1)) * np.tri(degree + 1)[::-1]
        added = height_of(patch.unstacked().with_waves(series), u, v) - height_of(patch, u, v)
        ends = [abs(series[4, 0]), abs(series[0, 4])] if degree == 4 else [0.0, 0.0]
        atol = 1e-12 + 9 / 16 * 35 / 8 * np.dot((2 / np.array(CELLS)) ** 4, ends)
        np.testing.assert_allclose(added, np.polynomial.legendre.legval2d(a, b, series), rtol=1e-9, atol=atol)
