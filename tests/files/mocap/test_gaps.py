"""Gaps: short ones filled and reported, others refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.files.mocap import Gap, MarkerTrajectories, fill_gaps, find_gaps

N = 100


def walk(*gaps):
    t = np.arange(N) / 100
    p = np.stack([np.sin(2 * np.pi * t + k)[:, None] * [0.1, 0.2, 0.3] for k in range(2)], axis=1)
    for marker, first, last in gaps:
        p[first : last + 1, marker] = np.nan
    return MarkerTrajectories(t, ("A", "B"), p, "walk.trc")


def test_a_smooth_motion_is_restored():
    holes = [(0, 10, 19), (1, 40, 44), (1, 60, 60)]
    filled, report = fill_gaps(walk(*holes), max_gap_s=0.1)
    error = np.abs(filled.positions - walk().positions).max(axis=(0, 2))
    assert error[0] < 2e-4  # 0.1 s of a 1 Hz swing of 0.37 m
    assert error[1] < 2e-5
    assert report == [Gap("A", 10, 19, True), Gap("B", 40, 44, True), Gap("B", 60, 60, True)]
    assert report[0].frames == 10


def test_a_cubic_is_restored_exactly():
    t = np.arange(N) / 100
    p = np.stack([t**3 - t, t**2, 2 * t], axis=1)[:, None]
    holed = p.copy()
    holed[30:38] = np.nan
    filled, _ = fill_gaps(MarkerTrajectories(t, ("A",), holed))
    np.testing.assert_allclose(filled.positions, p, atol=1e-12)


def test_without_gaps_nothing_happens():
    m = walk()
    filled, report = fill_gaps(m)
    assert filled is m
    assert report == []


@pytest.mark.parametrize(
    ("hole", "message"),
    [
        ((0, 10, 20), "'A' frames 11 to 21 .*at most 0.1 s .10 frames"),
        ((1, 0, 2), "'B' frames 1 to 3 at the start"),
        ((1, N - 1, N - 1), "'B' frames 100 to 100 at the end"),
        ((0, 0, N - 1), "'A' is never seen"),
    ],
)
def test_other_gaps_are_refused_by_name_and_frames(hole, message):
    holed = walk(hole, (1, 50, 52))
    with pytest.raises(InputError, match=message):
        fill_gaps(holed, max_gap_s=0.1)
    filled, report = fill_gaps(holed, max_gap_s=0.1, keep_long=True)
    assert [g.filled for g in report].count(False) == 1
    assert filled.missing.sum() == hole[2] - hole[1] + 1


def test_only_the_markers_asked_for_count():
    m = walk((0, 10, 60))
    assert fill_gaps(m.select(["B"]))[1] == []
    assert find_gaps(m) == [Gap("A", 10, 60, False)]


def test_a_negative_length_is_refused():
    with pytest.raises(InputError, match="longest gap to fill is -1"):
        fill_gaps(walk((0, 10, 11)), max_gap_s=-1)
