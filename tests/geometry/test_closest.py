"""Closest points against scipy.optimize, and the two facets of a groove that a button is too wide for."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, contact, fitted, groove_patch, look, patch_of, vec
from scipy.optimize import minimize

from pftwin.base.spatial import Rotation, Vec3
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.geometry.patch.closest import newton_step, rectangle_of
from pftwin.geometry.patch.implant import rig_implant
from pftwin.geometry.patch.polynomial import exponents
from pftwin.model.effects.contact_law import Flores, Hertz

J = jnp.asarray
GROOVE = groove_patch()
BUTTON = contact(Hertz(J(2e8)), GROOVE).recentred(vec(0, 0, 0))
CYLINDER = CylindricalChart(vec(0, 0, 0), Rotation.from_array(np.eye(3)), J(0.026))


def random_patch(seed: int, chart=None):
    c = 1e-3 * np.random.default_rng(seed).normal(size=len(exponents(5)))
    c[0] += 0.0 if chart is None else 0.026
    return patch_of(c, 5, (0.024, 0.02), chart)


@eqx.filter_jit
def descend(surface, c: Vec3, u, v, count: int = 25):
    """Where Newton's steps end, and the last of them."""

    def step(at, _):
        p = newton_step(surface, c, at[0], at[1], J(0.25 * RADIUS))
        return (p.u, p.v), p

    return jax.tree.map(lambda a: a[-1], jax.lax.scan(step, (u, v), None, length=count)[1])


one_step = eqx.filter_jit(newton_step)


@pytest.mark.parametrize("degrees", [-80, 60, 80])
def test_steps_of_a_large_sphere_do_not_go_round_the_axis(degrees):
    """Towards a centre 1 m away at the tangent's far end: steps of 120 mm would be 4.6 rad about a radius of 26 mm."""
    surface, radius = patch_of(np.eye(1, 21)[0] * 0.026, 5, (0.024, 0.02), CYLINDER), float(CYLINDER.radius)
    c = surface.chart.local_point(J(np.radians(degrees) * radius), J(0.0), J(1.0))
    u, v, way = J(0.0), J(0.0), [0.0]
    for _ in range(10):
        p = one_step(surface, c, u, v, J(0.12))
        u, v = p.u, p.v
        way.append(float(p.u))
    assert np.abs(way).max() < 1.05 * abs(np.radians(degrees)) * radius
    assert way[-1] == pytest.approx(np.radians(degrees) * radius, abs=1e-12)
    assert float(p.settled) == 1.0


@pytest.mark.parametrize("chart", [None, CYLINDER], ids=["plane", "cylinder"])
def test_newton_ends_where_scipy_ends(chart):
    """On gently curved patches, whose closest point is one, from starts some centimetre off."""
    rng = np.random.default_rng(2)
    for seed in range(4):
        surface = random_patch(seed, chart)
        for _ in range(4):
            u0, v0 = rng.uniform(-0.01, 0.01, 2)
            height = (0.0 if chart is None else 0.026) + rng.uniform(0.005, 0.02)
            c = surface.chart.local_point(J(u0), J(v0), J(height))
            point = np.asarray(c.array())

            def distance(x, surface=surface, point=point):
                u, v = J(x[0] * 1e-3), J(x[1] * 1e-3)
                s = np.asarray(POINT(surface, u, v))
                return float(np.linalg.norm(s - point)) * 1e3

            found = descend(surface, c, J(u0 + rng.uniform(-0.008, 0.008)), J(v0 + rng.uniform(-0.008, 0.008)))
            best = minimize(distance, [u0 * 1e3, v0 * 1e3], method="Nelder-Mead",
                            options={"xatol": 1e-7, "fatol": 1e-12})  # fmt: skip
            assert float(found.distance) * 1e3 == pytest.approx(best.fun, abs=1e-7)
            np.testing.assert_allclose([found.u * 1e3, found.v * 1e3], best.x, atol=1e-4)
            assert float(found.step) < 1e-9
            assert bool(found.settled)


@eqx.filter_jit
def POINT(surface, u, v):  # noqa: N802
    return surface.chart.local_point(u, v, surface.height(u, v)).array()


def test_distance_and_drift_are_derivatives():
    """The distance grows along the normal, and the closest point moves as drift says."""
    surface = random_patch(1)

    def closest(c):
        p = descend(surface, Vec3(*c), J(0.001), J(0.001))
        return jnp.stack([p.distance, p.u, p.v]), p

    c = J([0.002, -0.001, 0.012])
    _, p = closest(c)
    h = 1e-6
    slope = np.stack([(closest(c.at[i].add(h))[0] - closest(c.at[i].add(-h))[0]) / (2 * h) for i in range(3)], 1)
    np.testing.assert_allclose(slope[0], p.normal.array(), atol=1e-7)
    np.testing.assert_allclose(slope[1], p.drift_u.array(), atol=1e-6)
    np.testing.assert_allclose(slope[2], p.drift_v.array(), atol=1e-6)


ACROSS = np.linspace(-0.06, 0.06, 24001)
HEIGHT = np.asarray(jax.jit(lambda v: GROOVE.height(jnp.zeros_like(v), v))(J(ACROSS)))


def minima(y: float, z: float) -> np.ndarray:
    """Distances of all local minima from (0, y, z) to the groove, by a fine grid across it."""
    d2 = (ACROSS - y) ** 2 + (HEIGHT - z) ** 2
    k = np.flatnonzero((d2[1:-1] < d2[:-2]) & (d2[1:-1] <= d2[2:])) + 1
    curve = d2[k - 1] - 2 * d2[k] + d2[k + 1]
    lowest = d2[k] - (d2[k + 1] - d2[k - 1]) ** 2 / (8 * curve)
    return np.sort(np.sqrt(lowest))


BOTTOM = next(z for z in np.linspace(0.02, 0.04, 2001) if minima(0.0, z)[0] > RADIUS - 2e-5)  # lightly pressed in


def places(button, c: Vec3) -> list[tuple[float, float]]:
    now = eqx.tree_at(lambda n: n.patella.position, look(), c)
    return [(float(t.at.u), float(t.at.v)) for t in _both(button, now)]


@eqx.filter_jit
def _both(button, now):
    return button.touches(now, button.remember(now))[:2]


def test_a_point_does_not_lag_in_a_groove_nearly_as_round_as_the_sphere():
    """One step of Newton for each 0.5 ms of a sway across it: the normal keeps up with numpy's closest point.

    A normal that turns late pushes the sphere on after its turn, and feeds the sway.
    """
    half, bend = (0.024, 0.02), 1 / (2 * 1.04 * RADIUS)
    terms = {(0, 2): bend * half[1] ** 2, (0, 4): bend**3 * half[1] ** 4}
    surface = patch_of(np.array([terms.get(e, 0.0) for e in exponents(5)]), 5, half)
    time = 5e-4 * np.arange(200)
    y, z = 1.5e-4 * np.sin(2 * np.pi * time / 0.05), 1.001 * RADIUS

    @jax.jit
    def follow(centres):
        def step(v, c):
            p = newton_step(surface, Vec3(J(0.0), c, J(z)), J(0.0), v, J(0.12 * RADIUS))
            return p.v, p.v

        return jax.lax.scan(step, J(0.0), centres)[1]

    v = np.linspace(-0.018, 0.018, 36001)
    height = terms[0, 2] * (v / half[1]) ** 2 + terms[0, 4] * (v / half[1]) ** 4
    expected = np.array([v[np.argmin((v - c) ** 2 + (height - z) ** 2)] for c in y])
    assert np.ptp(expected) > 0.2 * RADIUS  # a sway of 0.3 mm carries the point over millimetres
    np.testing.assert_allclose(follow(J(y)), expected, atol=0.01 * RADIUS)


@pytest.mark.slow
def test_a_search_from_nothing_finds_both_facets():
    for y, facets in ((-0.002, 1), (-0.0003, 2), (0.0, 2), (0.0004, 2), (0.001, 1)):
        found = [np.hypot(v - y, GROOVE.height(J(u), J(v)) - BOTTOM) for u, v in places(BUTTON, vec(0, y, BOTTOM))]
        expected = minima(y, BOTTOM)
        assert len(expected) == facets
        np.testing.assert_allclose(sorted(found), np.resize(expected, 2), atol=1e-8)
    (_, medial), (_, lateral) = places(BUTTON, vec(0, 0, BOTTOM))
    assert medial == pytest.approx(-lateral, abs=1e-9)
    assert lateral > 0.002


ROWS = 8001  # of the longest path: the others go on where they end, so that one program serves all


def ride(button, path, velocities=None):
    """Contact force, indentations, shares and stored energy along a path of centres, memory carried on."""
    velocities = np.zeros_like(path) if velocities is None else velocities
    rows = np.minimum(np.arange(ROWS), len(path) - 1)
    found = _ride(button, J(path[rows]), J(velocities[rows]), J(STEP))
    return [np.asarray(a)[: len(path)] for a in found]


@eqx.filter_jit
def _ride(button, path, velocities, step):
    def at(p, v):
        return eqx.tree_at(lambda n: (n.patella.position, n.patella.velocity), look(), (Vec3(*p), Vec3(*v)))

    def move(memory, now):
        instant = at(*now)
        one, two, _ = button.touches(instant, memory)
        force = one.normal_force.term.wrench() + two.normal_force.term.wrench()
        load, memory = button.load(eqx.tree_at(lambda n: n.step, instant, step), memory)
        both = [jnp.stack(x) for x in ((one.indentation, two.indentation), (one.share, two.share))]
        return memory, (force.force.array(), *both, load.energy)

    return jax.lax.scan(move, button.remember(at(path[0], velocities[0])), (path, velocities))[1]


def resting_height(y: float, depth: float) -> float:
    """Where the deeper facet is indented by `depth`."""
    low, high = 0.015, 0.05
    for _ in range(40):
        z = 0.5 * (low + high)
        low, high = (z, high) if minima(y, z)[0] < RADIUS - depth else (low, z)
    return z


SWING, STEP = 0.001, 1e-3


@pytest.fixture(scope="module")
def path():
    """From side to side across the groove, 20 um deep in the nearer facet, one swing in eight seconds."""
    y, table = SWING * np.sin(np.linspace(0, 2 * np.pi, 8001)), np.linspace(-SWING, SWING, 161)
    height = np.interp(y, table, [resting_height(s, 2e-5) for s in table])
    return np.stack([0 * y, y, height], 1)


def forces(law, path):
    return ride(contact(law, GROOVE).recentred(vec(0, 0, 0)), path, np.gradient(path, axis=0) / STEP)


@pytest.fixture(scope="module")
def crossing(path):
    return forces(Hertz(J(2e8)), path)


def test_no_facet_is_lost_while_the_button_crosses_the_groove(path, crossing):
    _, indentation, share, _ = crossing
    alone = crossed = 0
    for i in range(0, len(path), 40):
        expected = RADIUS - minima(*path[i, 1:])
        counted = np.sort(indentation[i])[::-1]
        touching = expected[expected > 0]
        np.testing.assert_allclose(counted[: len(touching)], touching, atol=1e-8)
        if len(touching) == 1:  # nothing else is felt, and one contact is not felt twice
            assert counted[1] <= 0 or share[i].sum() == pytest.approx(1)
            alone += 1
        else:
            crossed += 1
    assert alone > 20
    assert crossed > 0


def test_force_does_not_rattle_between_facets(path, crossing):
    """Sums of Hertz forces over numpy's local minima, everywhere on the way."""
    force = np.linalg.norm(crossing[0], axis=1)
    assert np.abs(np.diff(force)).max() < 0.04 * force.max()  # between samples the other facet comes 0.4 um nearer
    single = 2e8 * 2e-5**1.5
    assert force.min() > 0.9 * single
    assert force.max() < 2 * single


def test_one_side_is_the_mirror_image_of_the_other(crossing):
    force, half = crossing[0], 4000
    forward, mirrored = force[:half], force[half : 2 * half]  # y changes its sign between the two
    np.testing.assert_allclose(forward[:, 1], -mirrored[:, 1], atol=1e-6)
    np.testing.assert_allclose(forward[:, 2], mirrored[:, 2], atol=1e-6)


@pytest.mark.slow
def test_remembered_approach_speeds_do_not_make_it_rattle_either(path):
    force = np.linalg.norm(forces(Flores(J(2e8), J(0.6)), path)[0], axis=1)
    assert np.abs(np.diff(force[1:])).max() < 0.05 * force.max()


def test_two_facets_melt_into_one_without_a_jump():
    """A shallow groove flattens along its length: its two facets meet in one floor, at a constant indentation."""
    surface = patch_of(MELTING, 5)
    u = np.linspace(-0.02, 0.02, 4001)
    button = contact(Hertz(J(2e8)), surface).recentred(vec(0, 0, 0))
    v = np.linspace(0, 0.019, 4000)
    height = np.asarray(jax.jit(jax.vmap(lambda u: surface.height(jnp.full(v.shape, u), J(v))))(J(u)))
    # Across the groove the button rests on the highest of the circles that touch it.
    rest = np.max(height + np.sqrt(RADIUS**2 - v**2), axis=1) - 2e-5
    force, _, share, _ = ride(button, np.stack([u, 0 * u, rest], 1))
    assert share[0].min() == 1
    np.testing.assert_allclose(share[-1], 0.5)
    change = np.linalg.norm(np.diff(force, axis=0), axis=1)
    assert change.max() < 0.01 * np.linalg.norm(force, axis=1).max()


def _melting() -> np.ndarray:
    """v^2 (curvature) falls from 80/m to 20/m along u, on either side of the button's 45/m; a quartic rim."""
    half = (0.024, 0.02)
    terms = {(0, 2): 25.0, (1, 2): -700.0, (0, 4): -6000.0}
    return np.array([terms.get(e, 0.0) * half[0] ** e[0] * half[1] ** e[1] for e in exponents(5)])


MELTING = _melting()


def test_a_facet_that_comes_into_being_beside_the_other_makes_no_jump():
    """Along a groove that narrows, a fifth of a millimetre off its middle: a second minimum appears next to the first,
    at first as a ledge, 2 mm away. On the way back it vanishes there.
    """
    surface = patch_of(MELTING, 5)
    button = contact(Hertz(J(2e8)), surface).recentred(vec(0, 0, 0))
    u = 0.018 * np.sin(np.linspace(0, 2 * np.pi, 8001))
    path = np.stack([u, np.full_like(u, 3e-5), 0 * u], 1)
    v = np.linspace(-0.01, 0.01, 4001)
    height = np.asarray(jax.jit(jax.vmap(lambda u: surface.height(jnp.full(v.shape, u), J(v))))(J(u)))
    path[:, 2] = np.max(height + np.sqrt(RADIUS**2 - (v - 3e-5) ** 2), axis=1)
    for _ in range(4):  # 20 um deep in the deeper facet
        _, indentation, _, _ = ride(button, path)
        path[:, 2] += np.max(indentation, axis=1) - 2e-5
    force, _, share, _ = ride(button, path)
    assert share.min() < 0.1  # a minimum has come and gone while the other stayed
    assert np.abs(np.diff(force, axis=0)).max() < 0.03 * np.linalg.norm(force, axis=1).max()


def test_a_point_that_has_not_converged_creates_no_indentation():
    """Beside a ridge, a point on its other side is far from the centre, which lies below the tangent plane there."""
    ridge, c = fitted(lambda u, v: -25 * v**2, 2), vec(0, 0.02, 0)
    samples = np.linspace(-0.02, 0.02, 4001)
    nearest = np.hypot(samples - 0.02, 25 * samples**2).min()
    p = one_step(ridge, c, J(0.0), J(-0.02), J(0.003))
    assert float(p.settled) == 0
    assert float(p.distance) > nearest


@pytest.mark.parametrize("surface", [rig_implant(), GROOVE], ids=["implant", "patch"])
def test_every_surface_says_where_it_ends(surface):
    """Within its rectangle nothing is outside, and 1 mm beyond each edge is 1 mm outside."""
    (u0, u1), (v0, v1) = rectangle_of(surface)
    middle = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    for u, v in ((u0, v0), (u1, v1), middle):
        assert float(surface.outside(jnp.asarray(u), jnp.asarray(v))) == pytest.approx(0, abs=1e-12)
    for u, v in ((u0 - 1e-3, middle[1]), (u1 + 1e-3, middle[1]), (middle[0], v0 - 1e-3), (middle[0], v1 + 1e-3)):
        assert float(surface.outside(jnp.asarray(u), jnp.asarray(v))) == pytest.approx(1e-3)
