"""Both facets where the fan across the groove ends before the contact does: on steep walls, and at a patch's edge."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, contact, fitted, flat_patch, look, patch_of, vec
from scipy.optimize import minimize

from pftwin import rig
from pftwin.geometry.contact.facets import ASTRAY, FAN, SPACING, FollowedPoint, follow_facets, scan_facets, tracked_from
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.model.effects.contact_law import Flores, Hertz

J = jnp.asarray
LAW = Hertz(J(2e8))


@eqx.filter_jit
def observed(button, now):
    return button.observe(now, button.remember(now))


bottom = eqx.filter_jit(lambda *given: scan_facets(*given)[0])
height_and_slope = eqx.filter_jit(lambda patch, v: jax.value_and_grad(patch.height, 1)(J(0.0), v))


@eqx.filter_jit
def section(patch, v):
    return jax.vmap(patch.height, (None, 0))(J(0.0), v)


def nearest(patch, center):
    """Distance from a point to the patch at u = 0 and the coordinate v of the nearest point, by samples."""
    v = np.linspace(-0.05, 0.05, 200_001)
    height = np.asarray(section(patch, J(v)))
    distance = np.hypot(v - center[1], height - center[2])
    return float(distance.min()), float(abs(v[np.argmin(distance)]))


def height_over(patch, v, depth):
    """Where a button whose centre is at (0, v) is indented by `depth`."""
    low, high = -0.05, 0.3
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if nearest(patch, (0, v, middle))[0] < RADIUS - depth else (low, middle)
    return high


@pytest.mark.parametrize(
    ("angle", "half"),
    [(60, 0.03), *(pytest.param(*p, marks=pytest.mark.slow) for p in ((48, 0.02), (55, 0.02), (60, 0.02), (70, 0.03)))],
)
def test_walls_steeper_than_the_fan_is_wide(angle, half):
    """A button wedged 0.1 mm deep between walls that it touches farther out than the fan's last sample."""
    patch = fitted(lambda u, v: np.sqrt(v**2 + 0.006**2) * np.tan(np.radians(angle)), 4, (0.024, half))
    high = height_over(patch, 0, 1e-4)
    distance, place = nearest(patch, (0, 0, high))
    assert place > FAN[-1] * RADIUS  # or this shows nothing
    seen = observed(contact(LAW, patch), look((0, 0, high)))
    for side, sign in (("medial", -1), ("lateral", 1)):
        assert float(seen[f"indentation_{side}"]) == pytest.approx(RADIUS - distance, abs=1e-8)
        assert float(seen[f"point_{side}"][1]) == pytest.approx(sign * place, abs=2e-6)


@pytest.mark.parametrize("half", [0.006, 0.010, 0.012])
@pytest.mark.parametrize("beside", [-0.004, 0.0, 0.004])
def test_a_patch_narrower_than_the_fan_is_one_contact(half, beside):
    """The button on a flat patch, where several of the fan's samples lie on its edge: the force of a wide one, once."""
    here = look((0, beside, RADIUS - 1e-4))
    narrow, wide = (observed(contact(LAW, p), here) for p in (patch_of([0.0] * 15, 4, (0.024, half)), flat_patch()))
    assert float(narrow["force"]) == pytest.approx(float(wide["force"]), rel=1e-9)
    np.testing.assert_array_equal(np.isnan(narrow["point_medial"]), np.isnan(wide["point_medial"]))


@pytest.mark.parametrize(("along", "twist", "across"), [(0.0, 25.0, 25.0), (0.0, 20.0, 20.0), (-10.0, 25.0, 20.0)])
@pytest.mark.parametrize("astray", [0.0, 0.004, 0.008])
def test_the_fan_finds_the_bottom_from_a_wrong_place_along_the_groove(along, twist, across, astray):
    """Below the centre of a twisted valley, f = a u^2 / 2 + b u v + c v^2 / 2, whose bottom across turns with u."""
    half = (0.024, 0.02)
    second = {(2, 0): along / 2 * half[0] ** 2, (1, 1): twist * half[0] * half[1], (0, 2): across / 2 * half[1] ** 2}
    valley = patch_of([second.get(ij, 0.0) for ij in exponents(2)], 2, half)
    found = bottom(valley, vec(0, 0, RADIUS - 1e-4), J(RADIUS), J(astray))
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_a_frame_shows_the_contact_that_the_step_has_had():
    """A button that the last step held on its medial facet alone, and that has come to touch the lateral one too: the
    velocity is the medial contact's doing, so the force seen is the law's there, not that of a blow on the other facet.
    """
    stiffness, restitution, floor = 2e8, 0.6, 0.01
    button = contact(Flores(J(stiffness), J(restitution)), fitted(lambda u, v: 25 * v**2, 2, (0.024, 0.02)))
    height = height_over(button.surface, 0, 3e-5)
    velocity = (0.0, 0.02, 0.0)  # away from the medial facet, into the lateral one
    now = look((0, 0, height), velocity)

    @eqx.filter_jit
    def seen(button, now):
        memory = button.remember(now)
        on_medial = memory._replace(places=(memory.places[0], memory.places[0]))
        load, _ = button.load(now, on_medial)
        return button.observe(now, on_medial), sum(term.force for term in load.stiff)

    distance, place = nearest(button.surface, (0, 0, height))
    assert place > 0.004  # two facets, or this shows nothing
    depth = RADIUS - distance
    rate = -velocity[1] * place / distance  # the normal leans from the medial facet to the lateral one
    damping = 8 * (1 - restitution) / (5 * restitution * floor)
    alone = stiffness * depth**1.5 * (1 + damping * rate)
    report, next_step = seen(button, now)
    assert float(next_step) > 2 * alone  # or there is no other contact to find
    assert float(report["force"]) == pytest.approx(alone, rel=1e-4)


def test_a_converged_point_stays_if_the_fan_finds_no_minimum():
    """A button at the rim of the rig's spline after a dislocation: the polynomial that the fan samples is 0.9 mm off
    there and puts the minimum at the fan's end, 3.3 mm from the true one. A restart there would strike the button on
    every other step, with several times the force.
    """
    scene = rig.case(2, contact="spline")
    surface, radius = scene.contact.surface, float(scene.contact.radius)
    c = surface.chart.to_frame(vec(4.1166e-3, 44.3687e-3, 42.8765e-3))

    @jax.jit
    def away(u, v):
        return (c - surface.chart.local_point(u, v, surface.height(u, v))).norm()

    true = minimize(lambda at: float(1e3 * away(*at)), (9.9e-3, 31.6e-3), method="Nelder-Mead", tol=1e-9).x
    (first, last), _ = eqx.filter_jit(scan_facets)(surface.unstacked(), c, J(radius), J(true[0]))
    middle = float(surface.chart.foot(c)[1])
    assert float(first) == float(last)
    assert true[1] - (middle + float(first) * radius) > ASTRAY * SPACING * radius  # or this shows nothing
    place = FollowedPoint(J(true[0]), J(true[1]), J(1.0), away(*true))
    found = eqx.filter_jit(follow_facets)(surface.unstacked(), c, J(radius), (place, place))
    nearest = min(found.medial, found.lateral, key=lambda p: float(p.distance))
    assert (float(nearest.u), float(nearest.v)) == pytest.approx(tuple(true), abs=1e-6)
    assert float(nearest.distance) == pytest.approx(float(away(*true)), abs=1e-9)


def touching(patch, v, depth=3e-5):
    """The centre of a button indented by `depth` at (0, v) of a patch over a plane, along the patch's normal there."""
    height, slope = map(float, height_and_slope(patch, J(v)))
    normal = np.array([0.0, -slope, 1.0]) / np.hypot(slope, 1.0)
    return (0.0, v, height) + (RADIUS - depth) * normal


@pytest.mark.parametrize("middle", [0.0, 0.002])
def test_a_contact_belongs_to_the_facet_of_its_side_of_the_groove(middle):
    """On a groove's walls, and beyond its ridges, where the surface leans the other way and the contact is on the other
    side of the button's centre: ridges at 9 mm from the bottom, 3 mm high.
    """

    def profile(u, v):
        x = ((v - middle) / 0.009) ** 2
        return 3e-3 * x * (2 - x)

    button = contact(LAW, fitted(profile, 4))
    beyond = (-0.012, -0.0105, 0.0105, 0.012)  # from the bottom, or both walls of the groove are touched
    for beside in beyond:
        seen = observed(button, look(touching(button.surface, middle + beside)))
        own, other = ("medial", "lateral") if beside < 0 else ("lateral", "medial")
        assert float(seen[f"force_{own}"]) == float(seen["force"]) == pytest.approx(2e8 * 3e-5**1.5, rel=1e-3)
        assert float(seen[f"point_{own}"][1]) == pytest.approx(middle + beside, abs=1e-5)
        assert float(seen[f"indentation_{own}"]) == pytest.approx(3e-5, rel=1e-3)
        assert float(seen[f"force_{other}"]) == 0
        assert np.isnan(float(seen[f"indentation_{other}"]))
        assert np.isnan(seen[f"point_{other}"]).all()
    height = height_over(button.surface, middle, 3e-5)
    both = observed(button, look((0, middle, height)))
    assert float(both["force_medial"]) == pytest.approx(float(both["force_lateral"]), rel=1e-4)


@pytest.mark.slow
def test_two_contacts_beyond_one_ridge_belong_to_one_facet():
    """A button in a dent beyond the groove's lateral ridge, on both walls of the dent."""
    dent, half = 0.016, (0.024, 0.026)

    def profile(u, v):
        return -4e-3 * np.exp(-((v / 0.005) ** 2)) - 2e-3 * np.exp(-(((v - dent) / 0.004) ** 2))

    button = contact(LAW, fitted(profile, 14, half))
    at = (0, dent, height_over(button.surface, dent, 3e-4))
    two = observed_touches(button, look(at))
    assert float(two[1].at.v - two[0].at.v) > 0.2 * RADIUS  # two contacts, or this shows nothing
    seen = observed(button, look(at))
    each = [float(t.normal_force.term.force) for t in two]
    assert min(each) > 0
    assert float(seen["force_lateral"]) == pytest.approx(sum(each), rel=1e-6)
    assert float(seen["indentation_lateral"]) == pytest.approx(max(float(t.indentation) for t in two), rel=1e-6)
    deeper = two[0] if each[0] > each[1] else two[1]
    assert float(seen["point_lateral"][1]) == pytest.approx(float(deeper.at.v), abs=1e-6)


@eqx.filter_jit
def observed_touches(button, now):
    return button.touches(now, button.remember(now))[:2]


class Misread(PolynomialPatch):
    """A patch whose fan samples another one, as that of a spline samples a polynomial near it."""

    sampled: PolynomialPatch

    def profile(self, u):
        return self.sampled.profile(u)


@eqx.filter_jit
def tracked(surface, path, places):
    """Distances of both points from the centres of a path (n, 3), (n, 2), from converged points (v, distance)."""

    def step(places, c):
        found = follow_facets(surface, vec(*c), J(RADIUS), places)
        points = found.medial, found.lateral
        return tuple(map(tracked_from, points)), jnp.stack([p.distance for p in points])

    starts = tuple(FollowedPoint(J(0.0), J(v), J(1.0), J(distance)) for v, distance in places)
    return jax.lax.scan(step, starts, J(path))[1]


def resting(c, steps=12):
    return np.tile(c, (steps, 1))


@pytest.mark.parametrize("seen", [(-0.008,), (0.008,), (-0.008, 0.008)])
def test_a_converged_point_outlasts_a_fan_that_contradicts_it(seen):
    """The button 30 um deep at the bottom of a valley, where the fan finds one or two minima elsewhere."""
    middle = 0.5 * (seen[0] + seen[-1])

    def contradicting(u, v):
        x = (v - middle) / 0.008
        return 25 * (v - middle) ** 2 if len(seen) == 1 else 2e-3 * x**2 * (x**2 - 2)

    other = fitted(contradicting, 4)
    c = (0.0, 0.0, RADIUS - 3e-5)
    valley = fitted(lambda u, v: 10 * v**2, 4)
    misread = Misread(valley.chart, valley.coefficients, valley.center, valley.half_size, 4, other)
    assert (np.abs(bottom(misread, vec(*c), J(RADIUS), J(0.0))) > ASTRAY * SPACING).all()  # or this shows nothing
    nearer = tracked(misread, resting(c), ((0.0, RADIUS), (0.0, RADIUS))).min(axis=1)
    np.testing.assert_allclose(nearer, RADIUS - 3e-5, atol=1e-9)


def test_neither_of_two_converged_points_leaves_for_a_minimum_that_only_the_fan_sees():
    """The button 30 um deep in both facets of a groove, where the fan samples a steeper groove, touched farther out."""
    groove, steeper = (
        fitted(lambda u, v, angle=angle: np.sqrt(v**2 + 0.003**2) * np.tan(np.radians(angle)), 8) for angle in (18, 35)
    )
    high = height_over(groove, 0, 3e-5)
    distance, place = nearest(groove, (0, 0, high))
    misread = Misread(groove.chart, groove.coefficients, groove.center, groove.half_size, 8, steeper)
    c = (0.0, 0.0, high)
    medial, lateral = (RADIUS * float(sample) for sample in bottom(misread, vec(*c), J(RADIUS), J(0.0)))
    assert place > 0.2 * RADIUS
    assert min(-medial, lateral) - place > ASTRAY * SPACING * RADIUS  # or this shows nothing
    np.testing.assert_allclose(
        tracked(misread, resting(c), ((-place, distance), (place, distance))), distance, atol=1e-7
    )


def test_a_point_without_contact_yields_to_a_facet_that_comes_near():
    """The button slides medially on the lateral facet of a groove with a dent beyond it; its lateral point is still at
    the dent's bottom, 3 mm away, when the medial facet touches.
    """

    def dented(u, v):
        dents = ((0.00330601, -0.01375197, 0.0088673), (-0.00282506, 0.0189133, 0.00532728))
        return 17.5184579 * v**2 + sum(a * np.exp(-(((v - c) / w) ** 2)) for a, c, w in dents)

    patch = fitted(dented, 12, (0.024, 0.026))
    path = np.array([(0.0, y, height_over(patch, y, 3e-5)) for y in np.linspace(3.6e-3, 2.5e-3, 12)])

    starts = (8.9e-3, RADIUS - 3e-5), (23.0e-3, 0.0243)
    deepest = [nearest(patch, c)[0] for c in path]
    np.testing.assert_allclose(tracked(patch, path, starts).min(axis=1), deepest, atol=2e-6)
    assert nearest(patch, path[-1])[1] > 8.5e-3  # the medial facet, or this shows nothing
