"""The taut line around an ellipsoid: great circles, geodesics, touch and lift-off, and what its directions say."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from taut_line_slopes import STEP, slopes

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid

RADII = np.array([0.02, 0.035, 0.013])
CENTER, TURN = np.array([0.004, -0.003, 0.002]), Rotation.from_rotvec([0.3, -0.5, 0.8])


def ellipsoid(radii: Any = RADII, center=(0, 0, 0), turn: Rotation | None = None) -> Ellipsoid:
    q = (turn or Rotation.identity()).as_quat(scalar_first=True)
    return Ellipsoid(vector(center), "femur", vector(radii), Quaternion(*(number(c) for c in q)))


@jax.jit
def _around(obstacle, start, end):
    return obstacle.around(start, end)


LINES = 20  # at most, so many that one program serves all tests


def around(obstacle, start, end) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths, directions at the starts and at the ends, of many lines."""
    starts, ends = (np.atleast_2d(p) for p in (start, end))
    line = _around(obstacle, *(vector(np.resize(p, (LINES, 3))) for p in (starts, ends)))
    out, back = (np.stack([w.x, w.y, w.z], axis=-1)[: len(starts)] for w in (line.at_start, line.at_end))
    return np.asarray(line.length)[: len(starts)], out, back


def test_on_a_sphere_it_is_two_tangents_and_a_great_circle():
    rng, r = np.random.default_rng(2), 0.025
    starts, ends = rng.uniform(0.02, 0.05, (2, 20, 3)) * [1, 1, 0.2]
    ends[:, :2] *= -1
    lengths, out, _ = around(ellipsoid((r, r, r), CENTER, TURN), CENTER + starts, CENTER + ends)
    far = [np.linalg.norm(p, axis=1) for p in (starts, ends)]
    angle = np.arccos(np.einsum("ij,ij->i", starts, ends) / (far[0] * far[1]))
    tangents = [np.sqrt(f**2 - r**2) for f in far]
    arcs = angle - sum(np.arccos(r / f) for f in far)
    assert (arcs > 0.3).all()
    np.testing.assert_allclose(lengths, sum(tangents) + r * arcs, atol=1e-8)
    inward = np.einsum("ij,ij->i", out, -starts) / far[0]
    np.testing.assert_allclose(inward, tangents[0] / far[0], atol=1e-7)


def geodesic(radii, start, end, guess) -> tuple[float, np.ndarray]:
    """Length and direction at the start of the line whose arc is a geodesic: by its equation, and shooting."""
    a = 1 / np.asarray(radii) ** 2

    def equation(_, y):
        x, v = y[:3], y[3:]
        normal = a * x
        return np.concatenate([v, -(a * v * v).sum() / (normal @ normal) * normal])

    def path(unknown):
        way = unknown[:3] / np.linalg.norm(unknown[:3])
        tangent, arc, rest = unknown[3:]
        touching = start + tangent * way
        solved = solve_ivp(equation, (0, arc), [*touching, *way], rtol=1e-10, atol=1e-13).y[:, -1]
        return way, touching, solved[:3] + rest * solved[3:]

    def residuals(unknown):
        way, touching, reached = path(unknown)
        on_it = [1e-2 * ((a * touching**2).sum() - 1), 1e-2 * way @ (a * touching) / np.linalg.norm(a * touching)]
        return np.array([*(reached - end), *on_it, 1e-2 * (np.linalg.norm(unknown[:3]) - 1)])

    found = least_squares(residuals, guess, x_scale=[1, 1, 1, 0.01, 0.01, 0.01], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(found.fun).max() < 1e-8
    return float(found.x[3:].sum()), path(found.x)[0]


PAIRS = [  # the line is 0.8 to 2 mm longer than straight
    ([0.031, 0.031, 0.002], [-0.021, -0.045, -0.012]),
    ([-0.026, -0.018, 0.030], [0.001, 0.001, -0.026]),
    ([0.032, -0.034, -0.009], [-0.043, 0.036, 0.033]),
    ([-0.046, 0.003, -0.002], [0.033, -0.048, 0.006]),
]


@pytest.mark.parametrize(("start", "end"), PAIRS)
def test_it_is_nearly_the_geodesic(start, end):
    start, end = np.array(start), np.array(end)
    (length,), (out,), _ = around(ellipsoid(), start, end)
    straight = np.linalg.norm(end - start)
    assert length > straight + 8e-4
    guess = [*out, 0.4 * length, 0.2 * length, 0.4 * length]
    exact, way = geodesic(RADII, start, end, guess)
    assert -1e-9 < length - exact < 1e-6
    assert np.degrees(np.arccos(np.clip(out @ way / np.linalg.norm(out), -1, 1))) < 0.02
    assert np.linalg.norm(out) == pytest.approx(1, abs=2e-6)


PLACE = st.integers(-60_000, 60_000).map(lambda k: 1e-6 * k)
POINT = st.tuples(PLACE, PLACE, PLACE)


def depth(point) -> float:
    """In the sphere, from the centre."""
    return float(np.linalg.norm(TURN.inv().apply(np.subtract(point, CENTER)) / RADII))


@settings(deadline=None, max_examples=150)
@given(start=POINT, end=POINT)
def test_what_holds_of_every_taut_line(start, end):
    obstacle = ellipsoid(center=CENTER, turn=TURN)
    straight = np.linalg.norm(np.subtract(end, start))
    (length,), (out,), (back,) = around(obstacle, start, end)
    assert length >= straight * (1 - 1e-12)
    assume(straight > 1e-3)
    assert 0.9 < np.linalg.norm(out) < 1.1
    reverse = around(obstacle, end, start)
    assert reverse[0][0] == pytest.approx(length, rel=1e-9)
    if min(depth(start), depth(end)) > 1.02:
        check_slopes(obstacle, start, end, out, back)


def check_slopes(obstacle, start, end, out, back):
    """Its length shortens as either end goes along the line, whatever the line touches."""
    found = slopes(lambda *ends: around(obstacle, *ends)[0], start, end)
    for (lengths, slope), way in zip(found, (out, back), strict=True):
        if np.ptp(lengths) < 3 * STEP:  # else it jumps from one side of the centre to the other
            np.testing.assert_allclose(slope, way, atol=1e-4)


def test_a_line_that_clears_it_is_straight():
    start, end = np.array([0.03, -0.04, 0.01]), np.array([0.03, 0.05, 0.012])
    (length,), (out,), (back,) = around(ellipsoid(), start, end)
    assert length == pytest.approx(np.linalg.norm(end - start), rel=1e-15)
    np.testing.assert_allclose([out, -back], np.broadcast_to((end - start) / length, (2, 3)), atol=1e-15)


def test_it_is_smooth_where_it_touches_and_lifts_off():
    top = np.array([0.006, 0.012, RADII[2] * np.sqrt(1 - 0.09 - (0.012 / 0.035) ** 2)])
    normal = top / RADII**2
    normal /= np.linalg.norm(normal)
    along = np.cross(normal, [0.2, 1.0, 0.3])
    along /= np.linalg.norm(along)
    sunk = np.array([-1e-5, -1e-7, -1e-9, 1e-9, 1e-7, 1e-5])[:, None] * normal
    lengths, out, back = around(ellipsoid(), top + sunk - 0.04 * along, top + sunk + 0.05 * along)
    assert np.ptp(lengths) < 1e-8
    assert np.ptp(out, axis=0).max() < 5e-4
    for directions in (out, back):
        assert np.ptp(directions[1:5], axis=0).max() < 5e-6
        assert np.ptp(directions[2:4], axis=0).max() < 1e-7


def test_from_inside_it_is_straight():
    end, inside = np.array([0.05, 0.02, 0.1]), np.array([0.001, 0.002, 0.0])
    assert around(ellipsoid(), inside, end)[0][0] == pytest.approx(np.linalg.norm(end - inside))


def _told(obstacle, start, end):
    """Length and both directions of one line, as one vector."""
    line = obstacle.around(start, end)
    return jnp.concatenate([line.length[None], line.at_start.array(), line.at_end.array()])


@jax.jit
def _told_and_slope(given, change):
    return jax.jvp(_told, given, change)


def slopes_of(given) -> list[np.ndarray]:
    """Of what is told of a line, forwards, by each number of the obstacle and of both ends."""
    leaves, tree = jax.tree.flatten(given)
    changes = (jax.tree.unflatten(tree, list(map(number, row))) for row in np.eye(len(leaves)))
    return [np.asarray(_told_and_slope(given, change)[1]) for change in changes]


@pytest.mark.parametrize(("start", "end"), [*PAIRS[:2], ([0.031, 0.031, 0.02], [-0.021, 0.045, 0.03])])
def test_derivatives_by_ends_and_obstacle_agree_with_finite_differences(start, end):
    """Around it, and, the last pair, clear of it."""
    given = ellipsoid(center=CENTER, turn=TURN), vector(np.add(start, CENTER)), vector(np.add(end, CENTER))
    slopes, (leaves, tree) = slopes_of(given), jax.tree.flatten(given)
    h = 1e-6
    for k, leaf in enumerate(leaves):
        moved = [[*leaves[:k], number(float(leaf) + d), *leaves[k + 1 :]] for d in (h, -h)]
        up, down = (np.asarray(_told_and_slope(jax.tree.unflatten(tree, m), given)[0]) for m in moved)
        np.testing.assert_allclose(slopes[k], (up - down) / (2 * h), rtol=1e-5, atol=2e-5)


@jax.jit
def _sums(obstacle, start, end):
    return jax.value_and_grad(lambda *a: (_told(*a) * jnp.arange(1.0, 8.0)).sum(), argnums=(0, 1, 2))(
        obstacle, start, end
    )


TOP = (0.0, 0.0, RADII[2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "end"),
    [
        PAIRS[0],
        ([-0.04, 0.0, RADII[2]], [0.05, 0.0, RADII[2]]),  # it touches in one point
        (TOP, [0.05, 0.0, RADII[2]]),  # from that point
        ([0.001, 0.002, 0.0], [0.05, 0.02, 0.1]),  # from inside
        ([0.0, 0.0, 0.0], [0.05, 0.02, 0.1]),  # from the centre
        ([-0.04, 0.0, 0.0], [0.05, 0.0, 0.0]),  # through the centre: either side is as good
        (TOP, TOP),
    ],
)
def test_reverse_derivatives_are_finite_and_those_forwards(start, end):
    given = ellipsoid(), vector(start), vector(end)
    backwards = jax.tree.leaves(_sums(*given)[1])
    forwards = [np.arange(1.0, 8.0) @ s for s in slopes_of(given)]
    assert np.isfinite(backwards).all()
    np.testing.assert_allclose(backwards, forwards, rtol=1e-9, atol=1e-9)


def test_depth_has_the_sign_of_the_equation_and_is_no_more_than_the_distance():
    """Against the distance from many points of the surface; in the middle it is the least radius."""
    rng, e = np.random.default_rng(5), ellipsoid(RADII, CENTER, TURN)
    surface = rng.normal(size=(100_000, 3))
    surface = TURN.apply(surface / np.linalg.norm(surface, axis=1, keepdims=True) * RADII)
    places, signs = rng.normal(size=(40, 3)) * 0.012, []
    *depths, deepest = np.asarray(
        jax.jit(lambda e, p: e.depth(p))(e, vector(CENTER + np.array([*places, np.zeros(3)])))
    )
    for p, depth in zip(places, depths, strict=True):
        signs.append(depth > 0)
        assert signs[-1] == (np.sum((TURN.inv().apply(p) / RADII) ** 2) < 1)
        assert depth < np.linalg.norm(surface - p, axis=1).min()
    assert set(signs) == {True, False}
    assert deepest == pytest.approx(RADII.min())
