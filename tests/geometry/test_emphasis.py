"""Weights of parts of a region."""

from __future__ import annotations

import numpy as np

from pftwin.geometry.patch.emphasis import WeightedPart, emphasis
from pftwin.geometry.patch.implant import rig_implant, rig_region


def at(angle: float, across: float) -> list[float]:
    """A point 25 mm from the trochlear axis [deg, mm]."""
    return [0.025 * np.sin(np.radians(angle)), 1e-3 * across, 0.025 * np.cos(np.radians(angle))]


def test_the_last_part_counts_and_elsewhere_the_weight_is_one():
    region = rig_region(rig_implant().mesh())
    parts = [
        WeightedPart(0.5, across=(-0.1, -0.01)),
        WeightedPart(3.0, angles=(0.0, 1.0)),
        WeightedPart(4.0, angles=(0.0, 1.0), across=(0.01, 0.02)),
    ]
    points = np.array([at(-20, 0), at(-20, -15), at(20, -15), at(20, 15), at(-20, 15), at(20, 25), at(70, 15)])
    np.testing.assert_array_equal(emphasis(region, parts)(points), [1, 0.5, 3, 4, 1, 3, 1])
    np.testing.assert_array_equal(emphasis(region, [])(points), np.ones(7))
