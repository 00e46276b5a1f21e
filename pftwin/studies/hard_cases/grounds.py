"""The surfaces that cases need beside the trochlea."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.studies.hard_cases.ground import Ground

Floats = NDArray[np.float64]


def groove(angle: float, rounding: float = 0.005, half: tuple[float, float] = (0.024, 0.02)) -> Ground:
    """A straight groove along x whose facets rise by an angle [deg], rounded at the bottom over a length [m]."""
    slope = np.tan(np.radians(angle))
    return Ground(lambda u, v: np.sqrt(v**2 + rounding**2) * slope, half)


def _ridge(u: Floats, v: Floats) -> Floats:
    return -np.sqrt(v**2 + 0.01**2) * np.tan(np.radians(20))


def _step_down(u: Floats, v: Floats) -> Floats:
    """A shallow groove between two shoulders beyond which it falls off."""
    return 0.002 * (1 - np.cos(np.pi * v / 0.02))


PLATE = Ground(lambda u, v: 0.0 * u, (0.1, 0.1), met=True)
VEE = groove(25)
RIDGE = Ground(_ridge, (0.03, 0.03))
SHALLOW = groove(1)
STEEP = groove(70, 0.006)
NARROW = groove(55, 0.002)
SMALL_PATCH = groove(18, 0.006, (0.004, 0.004))
SHOULDERS = Ground(_step_down, (0.03, 0.03))
