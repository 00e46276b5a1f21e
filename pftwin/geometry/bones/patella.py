"""The patella as a smooth body: two facets that meet in a ridge, a convex front, and an outline with an apex.

Patellar axes (x proximal, y lateral, z anterior), millimetres. The origin is on the ridge at half the height of the
articular surface.
"""

from __future__ import annotations

import math

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.implicit import smallest

ARTICULAR = 0.76  # share of the height that is articular (32.7 of 43 mm)
RIDGE_RADIUS = 6.0  # radius of the ridge in the transverse section [mm]
BLEND = 0.8  # length of the blend between surfaces at their edges [mm]
EDGE = 7.0  # thickness of the patella's border [mm]


class PatellaShape:
    """The patella's implicit function, positive inside.

    Raises InputError for facets so steep or wide that the patella would be thickest at its border.
    """

    def __init__(self, anatomy: Anatomy) -> None:
        a = self.anatomy = anatomy
        share = a.wiberg_ratio / (1 + a.wiberg_ratio)
        self.lateral, self.medial = share * a.patella_width_mm, (1 - share) * a.patella_width_mm
        half = 0.5 * ARTICULAR * a.patella_height_mm
        self.top, self.bottom = half, half - a.patella_height_mm
        self.edge = float(self.articular(np.asarray(0.5 * a.patella_width_mm))) + EDGE  # anterior of the ridge
        if self.edge > a.patella_thickness_mm:
            raise InputError(
                f"a patella {a.patella_width_mm:g} mm wide whose facets enclose {a.ridge_angle_deg:g} deg is thicker "
                f"than {a.patella_thickness_mm:g} mm at its border",
                where="patella_thickness_mm",
                expected=f"at least {math.ceil(10 * self.edge) / 10:g} mm",
            )

    def __call__(self, points: Floats) -> Floats:
        """Value (n,) [mm] at points (n, 3) [mm]."""
        x, y, z = points.T
        behind = z - self.articular(y) - 0.008 * np.maximum(-x - self.top, 0.0) ** 3
        return smallest(behind, self._front(x, y) - z, self._outline(x, y), blend=BLEND)

    def box(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Corners of a bounding box [mm]."""
        return (self.bottom - 5, -self.medial - 5, -5.0), (self.top + 5, self.lateral + 5, self.thickness + 5)

    @property
    def thickness(self) -> float:
        """Thickness from ridge to front [mm]."""
        return self.anatomy.patella_thickness_mm

    @property
    def middle(self) -> float:
        """Position of the outline's middle, lateral of the ridge [mm]."""
        return 0.5 * (self.lateral - self.medial)

    def articular(self, y: Floats) -> Floats:
        """Height of the articular surface anterior of the ridge [mm]: a hyperbola with the ridge angle.

        Both facets have the same inclination: the ridge angle's bisector points anteriorly.
        """
        slope = 1 / math.tan(math.radians(0.5 * self.anatomy.ridge_angle_deg))
        rounding = RIDGE_RADIUS * slope
        return slope * (np.sqrt(y * y + rounding**2) - rounding)

    def _front(self, x: Floats, y: Floats) -> Floats:
        """Front surface; most anterior over the origin, where the thickness is measured."""
        u = x / np.where(x > 0, self.top, -self.bottom)
        v = y / np.where(y > 0, self.lateral, self.medial)
        return self.thickness - (self.thickness - self.edge) * (0.6 * u * u + v * v)

    def _outline(self, x: Floats, y: Floats) -> Floats:
        """Outline: a rounded shield with the apex distal."""
        a = self.anatomy
        middle_x, middle_y = 0.5 * (self.top + self.bottom), self.middle
        u = (x - middle_x) / (0.5 * a.patella_height_mm)
        low = np.clip(-u, 0.0, 1.0)
        half = 0.5 * a.patella_width_mm * (1 - 0.45 * low**2)
        v = (y - middle_y) / half
        return 0.5 * a.patella_width_mm * (1 - (np.abs(u) ** 2.4 + np.abs(v) ** 2.4 + 1e-12) ** (1 / 2.4))
