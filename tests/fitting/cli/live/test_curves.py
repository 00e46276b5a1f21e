"""Curves against flexion: separate strokes, and no line across a dislocation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from live_engine import live_engine

from fitting.cli.live.curves import DASHED, DOTTED, SOLID, pieces, why_not_against_flexion


@pytest.fixture(scope="module")
def motion():
    return live_engine().model("groove").before


def cycle(motion, out=()):
    """A cycle from 10 to 50 and back in 41 frames."""
    flexion = 50 - 2.0 * np.abs(np.arange(41) - 20)
    return dataclasses.replace(motion, flexion=flexion, out=np.isin(np.arange(41), out))


def test_over_time_there_is_one_line(motion):
    (line,) = pieces(motion, against_flexion=False)
    np.testing.assert_array_equal(line.frames, np.arange(41))


def test_both_strokes_are_separate_and_rise_in_flexion(motion):
    shown = cycle(motion)
    bending, straightening = pieces(shown, against_flexion=True)
    assert (bending.dash, straightening.dash) == (SOLID, DASHED)
    np.testing.assert_array_equal(bending.frames, np.arange(21))
    np.testing.assert_array_equal(straightening.frames, np.arange(40, 19, -1))
    assert all((np.diff(shown.flexion[line.frames]) > 0).all() for line in (bending, straightening))


def test_no_line_goes_across_a_dislocation(motion):
    lines = pieces(cycle(motion, out=range(12, 30)), against_flexion=True)
    assert [line.dash for line in lines] == [SOLID, DOTTED, DOTTED, DASHED]
    assert [sorted(line.frames[[0, -1]].tolist()) for line in lines] == [[0, 11], [12, 20], [20, 29], [30, 40]]


def test_a_knee_that_hardly_bends_has_no_strokes(motion):
    assert why_not_against_flexion(dataclasses.replace(motion, flexion=np.full(41, 30.0))) == "the knee bends by 0 deg"
    assert why_not_against_flexion(cycle(motion)) == ""
