"""Strokes of a bending knee, and means over them, against what numpy says of the same numbers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.results.plots.strokes import FlexionCurve, band, by_outcome, common_grid, strokes_of


def test_three_cycles_have_three_strokes_each_way():
    t = np.linspace(0, 3, 601)
    flexion = 45 - 45 * np.cos(2 * np.pi * t)
    found = strokes_of(flexion)
    assert [s.bending for s in found] == [True, False] * 3
    for stroke in found:
        steps = np.diff(flexion[stroke.frames])
        assert (steps > 0).all() if stroke.bending else (steps < 0).all()
        assert np.ptp(flexion[stroke.frames]) == pytest.approx(90, abs=0.1)
    assert sum(s.frames.size for s in found) >= 601


def test_small_movements_to_and_fro_are_no_strokes():
    rng = np.random.default_rng(0)
    flexion = np.concatenate([np.linspace(0, 60, 301), np.linspace(60, 0, 301)]) + rng.normal(0, 0.5, 602)
    one, two = strokes_of(flexion)
    assert (one.bending, two.bending) == (True, False)
    assert abs(one.frames[-1] - 300) < 15
    assert (np.diff(flexion[one.frames]) > 0).all()
    assert (np.diff(flexion[two.frames]) < 0).all()


def test_a_recording_that_starts_half_way():
    flexion = np.concatenate([np.linspace(45, 90, 46), np.linspace(89, 0, 90), np.linspace(1, 50, 50)])
    found = strokes_of(flexion)
    assert [s.bending for s in found] == [True, False, True]
    np.testing.assert_allclose([flexion[s.frames[0]] for s in found], [45, 90, 0])
    np.testing.assert_allclose([flexion[s.frames[-1]] for s in found], [90, 0, 50])


@pytest.mark.parametrize(
    ("flexion", "message"),
    [
        (np.full(50, 30.0), "walk: the knee bends by 0 deg; expected: a motion of at least 5 deg"),
        (np.linspace(10, 12, 50), "bends by 2 deg"),
        (np.array([0.0, 30.0, np.nan, 60.0]), "flexion is not known everywhere"),
        (np.full(4, np.nan), "flexion is not known everywhere"),
    ],
)
def test_a_knee_that_does_not_bend_is_refused(flexion, message):
    with pytest.raises(InputError, match=message):
        strokes_of(flexion, "walk")


def test_band_is_mean_and_standard_deviation_over_strokes():
    rng = np.random.default_rng(1)
    courses = [(np.sort(rng.uniform(0, 90, 40)), rng.normal(size=40)) for _ in range(5)]
    courses = [(np.r_[0.0, x, 90.0], np.r_[y[0], y, y[-1]]) for x, y in courses]
    grid = common_grid([x for x, _ in courses])
    found = band(courses, grid)
    table = np.array([np.interp(grid, x, y) for x, y in courses])
    np.testing.assert_allclose(found.mean, table.mean(axis=0))
    np.testing.assert_allclose(found.sd, table.std(axis=0, ddof=1))
    assert (grid[0], grid[-1]) == (0, 90)


def test_where_strokes_end_the_line_is_broken():
    grid = np.linspace(0, 90, 91)
    found = band([(np.array([0.0, 90.0]), np.zeros(2)), (np.array([45.0, 90.0]), np.array([2.0, 2.0]))], grid)
    np.testing.assert_allclose(found.mean, np.where(grid < 45, 0, 1))
    assert np.isnan(found.sd[grid < 45]).all()
    np.testing.assert_allclose(found.sd[grid >= 45], np.sqrt(2))
    x, mean, _ = found.with_gaps()
    (gap,) = np.flatnonzero(np.isnan(x))
    assert (x[gap - 1], x[gap + 1]) == (44, 45)
    np.testing.assert_array_equal(np.delete(mean, gap), found.mean)


def test_missing_values_leave_the_others():
    grid = np.array([0.0, 1.0, 2.0])
    found = band([(grid, np.array([1.0, np.nan, 3.0])), (grid, np.array([2.0, 5.0, 4.0]))], grid)
    np.testing.assert_allclose(found.mean, [1.5, 5.0, 3.5])
    np.testing.assert_array_equal(np.isnan(found.sd), [False, True, False])
    assert np.isnan(band([], grid).mean).all()


def test_strokes_that_dislocate_are_never_averaged():
    """The third cycle leaves the groove on its way down and is still out on its way up: values there are 100."""
    t = np.linspace(0, 3, 601)
    flexion = 45 - 45 * np.cos(2 * np.pi * t)
    out = (t > 2.75) | ((t > 2.1) & (t < 2.2))
    values = np.where(out, 100.0, np.floor(t))
    grid = np.linspace(1, 89, 89)
    found = by_outcome([FlexionCurve(flexion, values, out, "walk")], grid)
    bending, straightening = found[", bending"], found[", straightening"]
    np.testing.assert_allclose(bending.band.mean, 0.5)  # of the first cycle and the second
    np.testing.assert_allclose(straightening.band.mean, 0.5)
    assert [len(f.band.there) for f in (bending, straightening)] == [2, 2]
    (up,), (down,) = bending.alone, straightening.alone
    assert set(np.unique(up.values)) == set(np.unique(down.values)) == {2.0, 100.0}
    np.testing.assert_array_equal(down.out, down.values == 100)
    assert down.flexion[0] > down.flexion[-1]  # in the order of time: it leaves where `out` begins
    assert down.flexion[np.argmax(down.out)] == pytest.approx(45, abs=2)


def test_strokes_of_both_directions_are_separated_by_outcome():
    flexion = np.concatenate([np.linspace(0, 60, 61), np.linspace(59, 0, 60)])
    out = np.arange(121) > 100
    found = by_outcome([FlexionCurve(flexion, flexion, out, "walk")], np.arange(61.0), "together")[""]
    assert len(found.band.there) == len(found.alone) == 1


def ramps(*flexions):
    """Knee flexion from one to the next by a degree a frame; one that comes twice is held for 20 frames."""
    parts = [np.full(20, float(a)) if a == b else np.arange(a, b, np.sign(b - a)) for a, b in pairwise(flexions)]
    return np.concatenate([*parts, [float(flexions[-1])]])


@pytest.mark.parametrize(
    ("flexion", "out", "averaged"),
    [
        (ramps(0, 60, 60, 0), slice(61, 80), (0, 0)),  # only while it is held: of both, whose ends it is
        (ramps(0, 30, 22, 60, 0), slice(32, 38), (0, 1)),  # only while it goes back for a moment
        (ramps(0, 60, 0), slice(60, 61), (0, 0)),  # only in the frame that both share
        (ramps(0, 60, 0, 0), slice(125, 130), (1, 0)),  # only when the movement is over
        (ramps(0, 0, 60, 0), slice(5, 10), (0, 1)),  # only before it begins
        (ramps(0, 60, 0), slice(0, 0), (1, 1)),
    ],
)
def test_no_frame_out_of_the_groove_is_overlooked(flexion, out, averaged):
    outside = np.zeros(flexion.size, dtype=bool)
    outside[out] = True
    found = by_outcome([FlexionCurve(flexion, flexion, outside, "walk")], np.arange(61.0)).values()
    assert tuple(len(f.band.there) for f in found) == averaged
    assert [len(f.alone) for f in found] == [1 - n for n in averaged]
    for course in (course for f in found for course in f.alone):
        assert course.out.sum() == outside.sum()
        np.testing.assert_array_equal(course.flexion[course.out], flexion[out])
