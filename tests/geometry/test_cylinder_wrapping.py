"""The taut line around a cylinder: helices, touch and lift-off, and what holds of every taut line."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from taut_line_slopes import STEP, slopes

from pftwin.base.leaves import number, vector
from pftwin.geometry.wrapping.cylinder import Cylinder

R = 0.03


def cylinder(side=None, axis=(0, 0, 1), center=(0, 0, 0)) -> Cylinder:
    return Cylinder(vector(center), "femur", number(R), vector(axis), None if side is None else vector(side))


@jax.jit
def _around(obstacle, start, end):
    return obstacle.around(start, end)


LINES = 6  # at most, so many that one program serves all tests


def around(obstacle, start, end) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, direction at the start and at the end, of one line or of several."""
    line = _around(obstacle, *(vector(np.resize(p, (LINES, 3))) for p in (start, end)))
    own = slice(len(start)) if np.ndim(start) > 1 else 0
    out, back = (np.stack([w.x, w.y, w.z], axis=-1)[own] for w in (line.at_start, line.at_end))
    return np.asarray(line.length)[own], out, back


def test_half_way_round_it_is_two_tangents_and_a_helix():
    # From (3 cm, -4 cm) to (-3 cm, -4 cm) over the far side: tangents of 4 cm along y, half a turn.
    length, out, back = around(cylinder((0, 1, 0)), (R, -0.04, 0.0), (-R, -0.04, 0.05))
    level = 0.08 + np.pi * R
    assert length == pytest.approx(np.hypot(level, 0.05), rel=1e-14)
    np.testing.assert_allclose(out, np.array([0, level, 0.05]) / length, atol=1e-14)
    np.testing.assert_allclose(back, np.array([0, level, -0.05]) / length, atol=1e-14)


def test_a_line_that_clears_it_is_straight():
    start, end = np.array([0.031, -0.04, 0.01]), np.array([0.031, 0.05, 0.03])
    length, out, back = around(cylinder(), start, end)
    assert length == pytest.approx(np.linalg.norm(end - start), rel=1e-15)
    np.testing.assert_allclose(out, (end - start) / length, atol=1e-15)
    np.testing.assert_allclose(back, -out, atol=1e-15)


def test_the_side_decides_where_both_are_possible():
    start, end = (-0.05, 0.001, 0.0), (0.05, 0.001, 0.0)  # a little nearer over +y
    over, under = (around(cylinder(side), start, end)[0] for side in ((0, 1, 0), (0, -1, 0)))
    assert around(cylinder(), start, end)[0] == over < under
    tangent, lean = np.sqrt(0.05**2 + 0.001**2 - R**2), np.arctan2(0.001, 0.05)
    arcs = [R * (np.pi + s * 2 * lean - 2 * np.arctan2(tangent, R)) for s in (-1, 1)]
    assert [over, under] == pytest.approx([2 * tangent + arc for arc in arcs], rel=1e-13)


def test_a_line_behind_it_is_held_over_its_side_all_the_way_round():
    # Straight it would pass behind the axis, clear of the cylinder; it has to come round the front.
    start, end = (-0.02, 0.05, 0.0), (-0.06, -0.05, 0.0)
    free, held = around(cylinder(), start, end)[0], around(cylinder((1, 0, 0)), start, end)[0]
    assert free == pytest.approx(np.hypot(0.04, 0.1))
    angle = np.arctan2(0.05, -0.02) + np.arctan2(0.05, -0.06)
    tangents = [np.sqrt(x**2 + y**2 - R**2) for x, y, _ in (start, end)]
    assert held == pytest.approx(sum(tangents) + R * (angle - sum(np.arctan2(t, R) for t in tangents)), rel=1e-13)


@jax.jit
def _slopes(start, end, obstacle):
    def everything(start, end, obstacle):
        line = obstacle.around(start, end)
        return jnp.stack([line.length, *line.at_start.array(), *line.at_end.array()])

    return jax.jacrev(everything, (0, 1, 2))(start, end, obstacle)


@pytest.mark.parametrize("inside", [(0, 0, 0), (0.01, -0.02, 0.3), (R, 0, 0)])
def test_from_inside_it_is_straight_with_finite_derivatives(inside):
    end = np.array([0.05, 0.02, 0.1])
    assert around(cylinder(), inside, end)[0] == pytest.approx(np.linalg.norm(end - inside))

    for ends in ((inside, end), (end, inside), (inside, inside)):
        for side in (None, (0, 1, 0)):
            slopes = _slopes(*(vector(p) for p in ends), cylinder(side))
            assert all(np.isfinite(s).all() for s in jax.tree.leaves(slopes))


PLACE = st.integers(-80_000, 80_000).map(lambda k: 1e-6 * k)
POINT = st.tuples(PLACE, PLACE, PLACE)
AXIS = (0.3, -0.5, 0.8)
CENTER = (0.004, -0.003, 0.002)


def outside(point) -> bool:
    axis, p = np.array(AXIS) / np.linalg.norm(AXIS), np.subtract(point, CENTER)
    return bool(np.linalg.norm(p - axis * (axis @ p)) > 1.02 * R)


@settings(deadline=None, max_examples=150)
@given(start=POINT, end=POINT, side=st.sampled_from([None, (1, 0, 0), (-0.2, 1, 0.4)]))
def test_what_holds_of_every_taut_line(start, end, side):
    obstacle = cylinder(side, AXIS, CENTER)
    length, out, back = around(obstacle, start, end)
    straight = np.linalg.norm(np.subtract(end, start))
    assert length >= straight * (1 - 1e-12)
    there_and_back = around(obstacle, end, start)
    assert there_and_back[0] == pytest.approx(length, rel=1e-12, abs=1e-15)
    np.testing.assert_allclose(there_and_back[2], out, atol=1e-9)
    if straight > 1e-6:
        assert np.linalg.norm(out) == pytest.approx(1)
        assert np.linalg.norm(back) == pytest.approx(1)
    if outside(start) and outside(end) and straight > 1e-3:
        check_slopes(obstacle, start, end, out, back)


def check_slopes(obstacle, start, end, out, back):
    """Its length shortens as either end goes along the line, whatever the line touches."""
    found = slopes(lambda *ends: around(obstacle, *ends)[0], start, end)
    for (lengths, slope), way in zip(found, (out, back), strict=True):
        if np.ptp(lengths) < 3 * STEP:  # else an end jumps from one side to the other
            np.testing.assert_allclose(slope, way, atol=2e-5)


def test_length_is_smooth_where_the_line_touches_and_lifts_off():
    # A line along x sinks onto the cylinder: length and directions go on without a step.
    heights = R + np.array([-1e-6, -1e-9, 1e-9, 1e-6])
    starts, ends = (np.stack([0 * heights + x, heights, 0 * heights], axis=1) for x in (-0.06, 0.05))
    lengths, out, _ = around(cylinder(), starts, ends)
    assert np.ptp(lengths) < 1e-8
    assert np.ptp(out, axis=0).max() < 1e-4
    assert np.ptp(out[1:3], axis=0).max() < 1e-7


def test_many_lines_at_once_and_derivatives_by_the_radius():
    rng = np.random.default_rng(0)
    aside = np.array([0.05, 0, 0])
    starts, ends = (rng.uniform(-0.02, 0.02, (5, 3)) + s * aside for s in (1, -1))
    together, out, _ = around(cylinder(), starts, ends)
    each = [around(cylinder(), s, e) for s, e in zip(starts, ends, strict=True)]
    np.testing.assert_allclose(together, [e[0] for e in each], rtol=1e-14)
    np.testing.assert_allclose(out, [e[1] for e in each], atol=1e-14)

    @jax.jit
    @jax.value_and_grad
    def length(radius, start, end):
        obstacle = Cylinder(vector((0, 0, 0)), "femur", radius, vector((0, 0, 1)))
        return obstacle.around(start, end).length

    for line in zip(starts[:2], ends[:2], strict=True):
        (above, _), (below, _), (_, slope) = (
            length(number(R + change), *(vector(p) for p in line)) for change in (1e-6, -1e-6, 0.0)
        )
        assert float(slope) == pytest.approx((float(above) - float(below)) / 2e-6, rel=1e-6)


def test_depth_is_the_radius_less_the_distance_from_the_axis():
    """Of points whose distances are known, by triangles with sides 3, 4 and 5 across an axis."""
    c, depth = cylinder(axis=(2, 0, 0), center=(0.01, -0.02, 0.04)), jax.jit(lambda c, p: c.depth(p))
    for along in (-0.5, 0.02):
        inside, outside = (vector((along, -0.02 + 3 * a, 0.04 - 4 * a)) for a in (0.005, 0.01))
        assert float(depth(c, inside)) == pytest.approx(0.005, abs=1e-15)
        assert float(depth(c, outside)) == pytest.approx(-0.02, abs=1e-15)
