"""The surfaces that cases need beside the trochlea, by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pftwin.studies.hard_cases.ground import TiltedGround
from pftwin.studies.hard_cases.knee import TROCHLEA

Floats = NDArray[np.float64]


def groove(angle: float, rounding: float = 0.005, half: tuple[float, float] = (0.024, 0.02)) -> TiltedGround:
    """A straight groove along x whose facets rise by an angle [deg], rounded at the bottom over a length [m]."""
    slope = np.tan(np.radians(angle))
    return TiltedGround(lambda u, v: np.sqrt(v**2 + rounding**2) * slope, half)


def _ridge(u: Floats, v: Floats) -> Floats:
    return -np.sqrt(v**2 + 0.01**2) * np.tan(np.radians(20))


def _step_down(u: Floats, v: Floats) -> Floats:
    """A shallow groove between two shoulders beyond which it falls off."""
    return 0.002 * (1 - np.cos(np.pi * v / 0.02))


PLATE = TiltedGround(lambda u, v: 0.0 * u, (0.1, 0.1), met=True)
SHALLOW = groove(1)
GROUNDS = {
    "plate": PLATE,
    "floor": TiltedGround(lambda u, v: 0.0 * u, (0.03, 0.03)),
    "vee": groove(25),
    "ridge": TiltedGround(_ridge, (0.03, 0.03)),
    "shallow": SHALLOW,
    "steep": groove(70, 0.006),
    "narrow": groove(55, 0.002),
    "small_patch": groove(18, 0.006, (0.004, 0.004)),
    "shoulders": TiltedGround(_step_down, (0.03, 0.03)),
    "edge": TiltedGround(TROCHLEA.height, (0.012, 0.012)),
    "no_width": TiltedGround(TROCHLEA.height, (0.024, 0.0)),
    # Long enough that it lies on it: flat, the trochlea's own rectangle ends 13 mm short of its equilibrium.
    "nearly_flat": replace(TROCHLEA, height=SHALLOW.height, half=(0.06, 0.03)),
    "nearly_vertical": TiltedGround(lambda u, v: np.sqrt(v**2 + 0.004**2) * np.tan(np.radians(80)), (0.02, 0.012)),
}
