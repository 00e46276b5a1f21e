"""The proximal tibia as a smooth body: a plateau, a tuberosity where the patellar tendon inserts, and a shaft.

The tibial frame coincides with the femoral frame in full extension; units are millimetres.
"""

from __future__ import annotations

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.femur import FLEXION_AXIS
from pftwin.geometry.bones.implicit import largest, smallest, smooth_step

GAP = 5.0  # between condyles and plateau: cartilage and menisci [mm]
TUBEROSITY_BELOW = 22.0  # distance below the plateau [mm]
TUBEROSITY_BEFORE = 24.0  # distance anterior of the trochlear axis [mm]
TUBEROSITY_HALF_WIDTH = 14.0  # [mm]
LENGTH = 120.0  # below the plateau [mm]
SHAFT_WIDTH = 27.0  # [mm]
BLEND = 1.5  # [mm]


class TibiaShape:
    """The tibia's implicit function, positive inside."""

    def __init__(self, anatomy: Anatomy) -> None:
        self.anatomy = anatomy
        self.plateau = FLEXION_AXIS[0] - anatomy.condyle_radius_mm - GAP  # height [mm]

    @property
    def tuberosity(self) -> tuple[float, float, float]:
        """Insertion of the patellar tendon, lateral of the groove by TT-TG [mm]."""
        return self.plateau - TUBEROSITY_BELOW, self.anatomy.tt_tg_mm, TUBEROSITY_BEFORE

    def __call__(self, points: Floats) -> Floats:
        """Value (n,) [mm] at points (n, 3) [mm]."""
        x, y, z = points.T
        with np.errstate(over="ignore", under="ignore"):
            return largest(self._shaft(x, y, z), self._bump(x, y, z), blend=2 * BLEND)

    def box(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Corners of a bounding box [mm]."""
        wide = max(0.5 * self.anatomy.epicondylar_width_mm, self.anatomy.tt_tg_mm + TUBEROSITY_HALF_WIDTH) + 6
        return (self.plateau - LENGTH - 6, -wide, -40.0), (self.plateau + 8, wide, TUBEROSITY_BEFORE + 8)

    def _shaft(self, x: Floats, y: Floats, z: Floats) -> Floats:
        below = self.plateau - x
        taper = smooth_step((below + 6) / 62)
        half_width = 0.5 * (self.anatomy.epicondylar_width_mm - 3) * (1 - taper) + 0.5 * SHAFT_WIDTH * taper
        front, back = 22 * (1 - taper) + 20 * taper, -30 * (1 - taper) - 8 * taper
        half_depth, middle = 0.5 * (front - back), 0.5 * (front + back)
        level = ((np.abs(y) / half_width) ** 2.3 + (np.abs(z - middle) / half_depth) ** 2.3 + 1e-12) ** (1 / 2.3)
        eminence = 5 * np.exp(-((y / 7) ** 2) - ((z + 6) / 11) ** 2)
        hollow = 1.5 * np.exp(-(((np.abs(y) - 21) / 11) ** 2) - ((z + 6) / 15) ** 2)
        round_about = np.minimum(half_width, half_depth) * (1 - level)
        return smallest(round_about, below + eminence - hollow, LENGTH - below, blend=BLEND)

    def _bump(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """An ellipsoid whose front is the tuberosity."""
        height, aside, before = self.tuberosity
        u, v, w = (x - height + 4) / 26, (y - aside) / TUBEROSITY_HALF_WIDTH, (z - before + 11) / 11
        return 11 * (1 - np.sqrt(u * u + v * v + w * w + 1e-12))
