"""The taut line around a sphere: great circles, touch and lift-off, and what holds of every taut line."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from taut_line_slopes import STEP, slopes

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.geometry.wrapping.sphere import Sphere

R = 0.03
CENTER = np.array([0.004, -0.003, 0.002])


def sphere(center=(0, 0, 0)) -> Sphere:
    return Sphere(vector(center), "femur", number(R))


@jax.jit
def _around(obstacle, start, end):
    return obstacle.around(start, end)


def around(obstacle, start, end) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, direction at the start and at the end, of one or many lines."""
    line = _around(obstacle, vector(start), vector(end))
    return np.asarray(line.length), np.asarray(line.at_start.array()), np.asarray(line.at_end.array())


@pytest.mark.parametrize("far", [0.031, 0.04, 0.2])
def test_between_ends_equally_far_it_is_two_equal_tangents_and_an_arc(far):
    """At angles of 60 to 179 deg seen from the centre, in planes of any direction; some lines miss the sphere."""
    angle = np.radians([60.0, 90.0, 120.0, 170.0, 179.0])
    one, two = np.array([2.0, -1.0, 2.0]) / 3, np.array([-2.0, -2.0, 1.0]) / 3  # at right angles
    ends = far * (np.cos(angle)[:, None] * one + np.sin(angle)[:, None] * two)
    lengths, out, back = around(sphere(CENTER), CENTER + np.tile(far * one, (5, 1)), CENTER + ends)
    arc = angle - 2 * np.arccos(R / far)
    over = np.where(arc > 0, 2 * np.sqrt(far**2 - R**2) + R * arc, 2 * far * np.sin(angle / 2))
    np.testing.assert_allclose(lengths, over, rtol=1e-14)
    aside = np.where(arc > 0, R / far, np.cos(angle / 2))  # of a direction, from that to the centre
    across = aside[:, None] * two - np.sqrt(1 - aside[:, None] ** 2) * one
    np.testing.assert_allclose(out, across, atol=1e-13)
    mirror = np.eye(3) - 2 * np.einsum("ij,ik->ijk", ends - far * one, ends - far * one) / (
        (ends - far * one) ** 2
    ).sum(axis=1).reshape(-1, 1, 1)
    np.testing.assert_allclose(back, np.einsum("ijk,ik->ij", mirror, out), atol=1e-12)


def test_it_is_that_around_an_ellipsoid_of_three_equal_radii():
    rng = np.random.default_rng(2)
    starts, ends = rng.uniform(-0.06, 0.06, (2, 200, 3))
    ball = Ellipsoid(vector(CENTER), "femur", vector((R, R, R)), Quaternion.identity())
    clear = min_distance(starts, ends) > R
    inside = np.minimum(*(np.linalg.norm(p - CENTER, axis=1) for p in (starts, ends))) < R
    assert min(clear.sum(), inside.sum(), (~clear & ~inside).sum()) > 9
    for own, other in zip(around(sphere(CENTER), starts, ends), around(ball, starts, ends), strict=True):
        np.testing.assert_allclose(own, other, atol=2e-6)


def min_distance(starts, ends) -> np.ndarray:
    """Of the straight lines from the centre."""
    along = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True)
    reach = np.clip(((CENTER - starts) * along).sum(axis=1), 0, np.linalg.norm(ends - starts, axis=1))
    return np.linalg.norm(starts + reach[:, None] * along - CENTER, axis=1)


PLACE = st.integers(-80_000, 80_000).map(lambda k: 1e-6 * k)
POINT = st.tuples(PLACE, PLACE, PLACE)


@settings(deadline=None, max_examples=150)
@given(start=POINT, end=POINT)
def test_what_holds_of_every_taut_line(start, end):
    obstacle = sphere(CENTER)
    length, out, back = around(obstacle, start, end)
    straight = np.linalg.norm(np.subtract(end, start))
    assert length >= straight * (1 - 1e-12)
    there_and_back = around(obstacle, end, start)
    assert there_and_back[0] == pytest.approx(length, rel=1e-12, abs=1e-15)
    if straight > 1e-6:
        assert np.linalg.norm(out) == pytest.approx(1)
        assert np.linalg.norm(back) == pytest.approx(1)
    if min(np.linalg.norm(np.subtract(p, CENTER)) for p in (start, end)) > 1.02 * R and straight > 1e-3:
        check_slopes(obstacle, start, end, out, back)


def check_slopes(obstacle, start, end, out, back):
    """Its length shortens as either end goes along the line, whatever the line touches."""
    found = slopes(lambda *ends: around(obstacle, *ends)[0], start, end)
    for (_, slope), way in zip(found, (out, back), strict=True):
        if min_distance(np.array([start]), np.array([end]))[0] > 10 * STEP:  # else it jumps to the other side
            np.testing.assert_allclose(slope, way, atol=2e-5)


def sinking(depths) -> tuple[np.ndarray, np.ndarray]:
    """Ends of lines that would pass straight by the sphere's surface at depths below it."""
    top, along = np.array([2.0, -1.0, 2.0]) / 3, np.array([-2.0, -2.0, 1.0]) / 3
    at = CENTER + (R - np.asarray(depths))[:, None] * top
    return at - 0.06 * along, at + 0.05 * along


def test_it_is_smooth_where_it_touches_and_lifts_off():
    """Length and directions; and the length's slope is the directions, on both sides and in the very contact."""
    depths = np.array([-1e-6, -1e-9, 0.0, 1e-9, 1e-6])
    lengths, out, back = around(sphere(CENTER), *sinking(depths))
    assert np.ptp(lengths) < 1e-8
    for directions in (out, back):
        assert np.ptp(directions, axis=0).max() < 1e-4
        assert np.ptp(directions[1:4], axis=0).max() < 1e-7
    for k, (start, end) in enumerate(zip(*sinking(depths), strict=True)):
        check_slopes(sphere(CENTER), start, end, out[k], back[k])


def _told(obstacle, start, end):
    """Length and both directions of one line, as one vector."""
    line = obstacle.around(start, end)
    return jnp.concatenate([line.length[None], line.at_start.array(), line.at_end.array()])


_told_at = jax.jit(_told)
_slopes_of = jax.jit(jax.jacfwd(_told, argnums=(0, 1, 2)))
_backwards_of = jax.jit(jax.jacrev(_told, argnums=(0, 1, 2)))
OVER, BESIDE = ([-0.05, 0.01, 0.005], [0.045, 0.012, -0.01]), ([-0.05, 0.04, 0.005], [0.045, 0.03, -0.01])


@pytest.mark.parametrize(("start", "end"), [OVER, BESIDE])
def test_derivatives_by_ends_and_obstacle_agree_with_finite_differences(start, end):
    given = sphere(CENTER), vector(start), vector(end)
    leaves, tree = jax.tree.flatten(given)
    for k, slope in enumerate(jax.tree.leaves(_slopes_of(*given))):
        moved = (jax.tree.unflatten(tree, [*leaves[:k], leaves[k] + d, *leaves[k + 1 :]]) for d in (1e-6, -1e-6))
        up, down = (np.asarray(_told_at(*m)) for m in moved)
        np.testing.assert_allclose(slope, (up - down) / 2e-6, rtol=1e-6, atol=1e-6)


TOP = (0.0, 0.0, R)
SPECIAL = {
    "touching": ((-0.04, 0.0, R), (0.05, 0.0, R)),
    "from the surface": (TOP, (0.05, 0.0, R)),
    "between opposite points of the surface": (TOP, (0.0, 0.0, -R)),
    "from inside": ((0.001, 0.002, 0.0), (0.05, 0.02, 0.1)),
    "from the centre": ((0.0, 0.0, 0.0), (0.05, 0.02, 0.1)),
    "through the centre": ((-0.04, 0.0, 0.0), (0.05, 0.0, 0.0)),
    "through the centre, askew": ((-0.04, 0.02, 0.06), (0.02, -0.01, -0.03)),
    "nearly through the centre": ((-0.04, 1e-12, 3e-12), (0.05, 0.0, 0.0)),
    "away from the centre": ((0.04, 0.02, 0.0), (0.08, 0.04, 0.0)),
    "of no length": (TOP, TOP),
    "of no length, outside": ((0.04, 0.02, 0.0), (0.04, 0.02, 0.0)),
}


@pytest.mark.parametrize(("start", "end"), SPECIAL.values(), ids=SPECIAL)
def test_derivatives_are_finite_everywhere(start, end):
    given = sphere(), vector(start), vector(end)
    forwards, backwards = (jax.tree.leaves(of(*given)) for of in (_slopes_of, _backwards_of))
    assert all(np.isfinite(slope).all() for slope in forwards)
    for one, other in zip(forwards, backwards, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("aside", [0.0, 1e-12, -1e-12, 1e-10, -1e-10, 1e-8, 1e-6])
@pytest.mark.parametrize("way", [(1.0, 0.0, 0.0), (-2.0, 1.0, 3.0), (0.0, 0.0, -1.0)])
def test_through_the_centre_it_goes_round_in_some_plane_and_its_slope_is_its_directions(way, aside):
    """Where the centre is on the straight line, or off it by hardly anything."""
    along = np.array(way) / np.linalg.norm(way)
    side = np.cross(along, [0.3, -0.5, 0.2])
    start, end = -0.05 * along, 0.04 * along + aside * side
    length, out, back = around(sphere(), start, end)
    arc = np.pi - np.arccos(R / 0.05) - np.arccos(R / 0.04)
    assert length == pytest.approx(0.04 + np.sqrt(0.04**2 - R**2) + R * arc, abs=2 * abs(aside) + 1e-12)
    slopes = _slopes_of(sphere(), vector(start), vector(end))
    for of, direction in zip(slopes[1:], (out, back), strict=True):
        assert np.linalg.norm(direction) == pytest.approx(1)
        np.testing.assert_allclose([s[0] for s in (of.x, of.y, of.z)], -direction, atol=1e-6)


def test_from_inside_it_is_straight():
    end, inside = np.array([0.05, 0.02, 0.1]), np.array([0.001, 0.002, 0.0])
    length, out, back = around(sphere(), inside, end)
    assert length == pytest.approx(np.linalg.norm(end - inside))
    np.testing.assert_allclose([out, -back], [(end - inside) / length] * 2, atol=1e-15)


def test_depth_is_the_radius_less_the_distance_from_the_centre():
    """Of points whose distances are known: a box of sides 1, 2 and 2 has a diagonal of 3."""
    for scale, depth in ((0.0, R), (0.005, 0.015), (0.01, 0.0), (0.02, -0.03)):
        point = vector(CENTER + scale * np.array([1.0, -2.0, 2.0]))
        assert float(sphere(CENTER).depth(point)) == pytest.approx(depth, abs=1e-15)
