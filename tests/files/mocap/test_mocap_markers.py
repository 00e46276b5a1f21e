"""Marker trajectories and tables as values."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.files.mocap import MarkerTrajectories, Table, mirror_left_markers

T = np.arange(10) / 100


def markers(times=T, names=("R_Knee", "R_Ankle", "L_Knee"), positions=None):
    return MarkerTrajectories(times, names, np.ones((len(T), 3, 3)) if positions is None else positions, "walk.trc")


def test_selection_and_unknown_names():
    m = markers(positions=np.arange(90.0).reshape(10, 3, 3))
    np.testing.assert_array_equal(m.select(["L_Knee", "R_Knee"]).positions, m.positions[:, [2, 0]])
    np.testing.assert_array_equal(m.marker("R_Ankle"), m.positions[:, 1])
    with pytest.raises(InputError, match=r"walk\.trc: no marker called 'r_knie'.*did you mean 'R_Knee'"):
        m.marker("r_knie")
    with pytest.raises(InputError, match="no marker called 'Q'"):
        m.select(["Q"])


def test_between():
    m = markers().between(0.02, 0.05)
    np.testing.assert_allclose(m.times, [0.02, 0.03, 0.04, 0.05])
    with pytest.raises(InputError, match=r"no frame between 5 s and 6 s; expected: an interval within 0 s to 0\.09 s"):
        markers().between(5, 6)


def test_rounded_times_become_an_even_grid():
    rounded = np.round(np.arange(10) / 120, 3)
    m = markers(times=rounded)
    np.testing.assert_allclose(np.diff(m.times), 0.075 / 9)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (np.where(np.arange(10) == 4, np.nan, T), "row 5 has no finite time"),
        (np.where(np.arange(10) == 4, T[3], T), "row 5 repeats the time 0.03 s"),
        (T[::-1], "row 2 goes back in time: 0.08 s after 0.09 s"),
        (np.where(np.arange(10) > 4, T + 0.02, T), "not evenly spaced: 0.03 s between rows 5 and 6"),
        (np.zeros((10, 1)), r"times of shape \(10, 1\)"),
    ],
)
def test_bad_times(times, message):
    with pytest.raises(InputError, match=message):
        markers(times=times)


def test_bad_shapes_names_and_values():
    with pytest.raises(InputError, match=r"positions of shape \(10, 2, 3\)"):
        markers(positions=np.ones((10, 2, 3)))
    with pytest.raises(InputError, match="occur twice: A"):
        markers(names=("A", "B", "A"))
    p = np.ones((10, 3, 3))
    p[2, 1, 0] = np.inf
    with pytest.raises(InputError, match="'R_Ankle' is infinite on row 3"):
        markers(positions=p)
    with pytest.raises(InputError, match="one frame has no sampling rate"):
        _ = MarkerTrajectories(np.zeros(1), ("A",), np.ones((1, 1, 3))).rate


def test_a_coordinate_that_is_missing_makes_the_marker_missing():
    p = np.ones((10, 3, 3))
    p[2, 1, 0] = np.nan
    assert np.isnan(markers(positions=p).positions[2, 1]).all()


def test_mirrored_markers():
    p = np.random.default_rng(0).normal(size=(10, 3, 3))
    m = markers(positions=p)
    mirrored = mirror_left_markers(m, medial_lateral="z")
    np.testing.assert_array_equal(mirrored.positions, p * [1, 1, -1])
    np.testing.assert_array_equal(mirror_left_markers(mirrored, medial_lateral="z").positions, p)
    with pytest.raises(InputError, match="axis 'w'"):
        mirror_left_markers(m, medial_lateral="w")


def test_tables():
    t = Table(T, ("force", "angle"), np.ones((10, 2)), {"force": "N"})
    assert t.units == {"force": "N", "angle": ""}
    assert t.rate == pytest.approx(100)
    assert t.between(0, 0.03).times.size == 4
    assert t.select(["angle"]).names == ("angle",)
    with pytest.raises(InputError, match="did you mean 'force'"):
        t.column("forces")
    with pytest.raises(InputError, match="not evenly spaced"):
        _ = Table(T**2 + T, ("a",), np.ones((10, 1))).rate
    with pytest.raises(InputError, match=r"values of shape \(10, 1\)"):
        Table(T, ("a", "b"), np.ones((10, 1)))
