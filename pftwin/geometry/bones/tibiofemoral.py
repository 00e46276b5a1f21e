"""The distal femur and the proximal tibia as smooth bodies.

Femoral axes (x proximal, y lateral, z anterior), origin on the trochlear axis, millimetres; the tibia's frame coincides
with the femur's in full extension. The femur has a trochlea, two condyles with a notch between them, and a shaft.
Behind and below the axis its surface is a radius as a function of the angle about it, above it a height as a function
of x. Across, each facet rises from the groove to its ridge and falls beyond it to the condyle's side. Curvature is
continuous in the trochlea. The tibia has a plateau, a tuberosity where the patellar tendon inserts, and a shaft.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.geometry.bones.anatomy import EPICONDYLE, RIDGE_TO_SIDE, Anatomy
from pftwin.geometry.bones.implicit import largest, smallest, smooth_step

SHAFT_LENGTH = 110.0  # above the trochlear axis [mm]
SHAFT_WIDTH, SHAFT_DEPTH = 28.0, 27.0  # of the shaft [mm]
# Centre (x, z) of the condyles' circles, about which the tibia rotates, from the trochlear axis [mm]. An assumption.
FLEXION_AXIS = -5.0, -8.0
NOTCH_FLOOR = 9.0  # distance of the notch's floor from the axis [mm]
# Start and length of transitions, as angles distal of anterior [deg]: the groove sinks into the notch, the ridges'
# heights become those of the condyles, and the ridges diverge to the condyles' crests.
TO_NOTCH, TO_CONDYLE, TO_CREST = (45.0, 60.0), (30.0, 65.0), (50.0, 60.0)
CONDYLE_HALF_WIDTH = 13.0  # from a condyle's crest to its side [mm]
GROOVE_ROUNDING, RIDGE_ROUNDING = 0.30, 0.25  # shares of a facet's width that are curved, at either end
SIDE_POWER = 2.5  # exponent of the superellipse from ridge to side: no curvature at the ridge
BLEND = 1.5  # length of the blend of trochlea and shaft; its effect where the patella tracks is below 1 um [mm]
TROCHLEA_TOP = 32.0  # height above the axis at which the facets end [mm]


class _Profile(NamedTuple):
    """Parameters of the transverse section at each point [mm]."""

    floor: Floats  # the groove's radius, or height above the axis
    lateral: Floats  # the lateral ridge's radius or height
    medial: Floats  # the medial ridge's
    lateral_at: Floats  # the lateral ridge's distance from the groove
    medial_at: Floats  # the medial ridge's
    half_width: Floats  # of the condyles


class FemurShape:
    """The femur's implicit function, positive inside."""

    def __init__(self, anatomy: Anatomy) -> None:
        self.anatomy = anatomy

    def __call__(self, points: Floats) -> Floats:
        """Value (n,) [mm] at points (n, 3) [mm]."""
        with np.errstate(over="ignore", under="ignore"):
            return largest(self._joint(points), self._shaft(points), blend=BLEND)

    def box(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Corners of a bounding box [mm]."""
        a = self.anatomy
        ridges = a.trochlear_radius_mm + max(a.lateral_height_mm, a.medial_height_mm)
        extent = max(a.condyle_radius_mm - FLEXION_AXIS[0], ridges) + 8
        wide = 0.5 * a.epicondylar_width_mm + 6
        back = max(a.condyle_radius_mm - FLEXION_AXIS[1], SHAFT_DEPTH + a.prominence_mm - a.trochlear_radius_mm) + 8
        return (-extent, -wide, -back), (SHAFT_LENGTH + 6, wide, extent + max(0.0, -a.prominence_mm))

    def _joint(self, points: Floats) -> Floats:
        x, y, z = points.T
        above, back = x > 0, z < 0
        out = np.where(above, np.abs(z), np.hypot(x, z))
        around = np.mod(np.degrees(np.arctan2(-x, z)), 360.0)
        p = self._profile(np.where(above, np.where(back, 180.0, 0.0), around), np.where(above, x, 0.0), back)
        side = y > 0
        at = np.where(side, p.lateral_at, p.medial_at)
        top = np.where(side, p.lateral, p.medial)
        across = np.abs(y)
        surface = p.floor + (top - p.floor) * facet(np.minimum(across / at, 1.0))
        aside = np.maximum(across - at, 0.0) / (p.half_width - at)
        level = ((out / surface) ** SIDE_POWER + aside**SIDE_POWER + 1e-12) ** (1 / SIDE_POWER)
        within = self.anatomy.trochlear_radius_mm * (1 - level)
        return smallest(within, TROCHLEA_TOP + 2 - x, blend=0.5 * BLEND)

    def _profile(self, angle: Floats, x: Floats, back: NDArray[np.bool_]) -> _Profile:
        """Section at an angle from anterior over distal to posterior [deg], and a height above the axis [mm]."""
        a = self.anatomy
        radius, half = a.trochlear_radius_mm, 0.5 * a.epicondylar_width_mm - EPICONDYLE
        receding = self.recession(x)
        rounded = np.where(back, np.cos(np.minimum(x / a.condyle_radius_mm, 1.4)), 1.0)  # the condyles' upper ends
        fading = 1 - smooth_step((x - 6) / (TROCHLEA_TOP - 6))
        to_notch, to_condyle, to_crest = (
            smooth_step((angle - first) / width) for first, width in (TO_NOTCH, TO_CONDYLE, TO_CREST)
        )
        condyles = _distance_to_circle(angle, a.condyle_radius_mm)
        crest = half - CONDYLE_HALF_WIDTH

        def blended(anterior: Floats, behind: Floats | float, share: Floats) -> Floats:
            return rounded * ((1 - share) * anterior + share * behind)

        def ridge(height: float) -> Floats:
            return blended(radius - receding + height * fading, condyles, to_condyle)

        def aside(width: float) -> Floats:
            return width + (crest - width) * to_crest

        narrowing = (half - 0.5 * SHAFT_WIDTH - 8) * smooth_step(x / TROCHLEA_TOP)
        width = np.maximum(half - narrowing, max(a.lateral_facet_mm, a.medial_facet_mm) + RIDGE_TO_SIDE)
        lateral, medial = (np.minimum(aside(w), width - RIDGE_TO_SIDE) for w in (a.lateral_facet_mm, a.medial_facet_mm))
        floor = blended(radius - receding, NOTCH_FLOOR, to_notch)
        return _Profile(floor, ridge(a.lateral_height_mm), ridge(a.medial_height_mm), lateral, medial, width)

    def recession(self, x: Floats) -> Floats:
        """Distance of the groove's floor behind its most anterior point at a height x above the axis [mm]."""
        a = self.anatomy
        t = np.clip(x / TROCHLEA_TOP, 0.0, 1.0)
        round_off = 0.5 * TROCHLEA_TOP**2 / a.trochlear_radius_mm * t**2 * (1 - t) ** 3
        return (a.prominence_mm + 1.5) * smooth_step(t) + round_off

    def _shaft(self, points: Floats) -> Floats:
        x, y, z = points.T
        a = self.anatomy
        cortex = a.trochlear_radius_mm - a.prominence_mm
        rise, taper = smooth_step((x - 6) / 30), smooth_step((x + 4) / 72)
        front = cortex - 12 * (1 - rise)
        back = (6 - a.condyle_radius_mm + FLEXION_AXIS[1]) * (1 - taper) + (cortex - SHAFT_DEPTH) * taper
        half_width = 0.5 * a.epicondylar_width_mm * (1 - taper) + 0.5 * SHAFT_WIDTH * taper
        half_depth = 0.5 * (front - back)
        middle = 0.5 * (front + back)
        level = ((np.abs(y) / half_width) ** 2.5 + (np.abs(z - middle) / half_depth) ** 2.5) ** 0.4
        round_about = np.minimum(half_width, half_depth) * (1 - level)
        return smallest(round_about, x + 9, SHAFT_LENGTH - x, blend=BLEND)


def _distance_to_circle(angle: Floats, radius: float) -> Floats:
    """Distance [mm] from the trochlear axis to the condyles' circle, at an angle from anterior over distal [deg]."""
    x, z = FLEXION_AXIS
    along = -x * np.sin(np.radians(angle)) + z * np.cos(np.radians(angle))
    return along + np.sqrt(radius**2 - x * x - z * z + along**2)


def facet(t: Floats) -> Floats:
    """Profile from groove (0) to ridge (1): flat at the ends, straight between, with continuous curvature."""
    a, b = GROOVE_ROUNDING, RIDGE_ROUNDING
    x, y = np.clip(t / a, 0.0, 1.0), np.clip((t - 1 + b) / b, 0.0, 1.0)
    straight = np.clip(t, a, 1 - b) - a
    bend = a * (x**3 - 0.5 * x**4) + straight + b * (y - y**3 + 0.5 * y**4)
    return bend / (1 - 0.5 * (a + b))


GAP = 5.0  # between condyles and plateau: cartilage and menisci [mm]
TUBEROSITY_BELOW = 22.0  # distance below the plateau [mm]
TUBEROSITY_BEFORE = 24.0  # distance anterior of the trochlear axis [mm]
TUBEROSITY_HALF_WIDTH = 14.0  # [mm]
TIBIA_LENGTH = 120.0  # of the shaft below the plateau [mm]
TIBIA_WIDTH = 27.0  # of the shaft [mm]


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
        return (self.plateau - TIBIA_LENGTH - 6, -wide, -40.0), (self.plateau + 8, wide, TUBEROSITY_BEFORE + 8)

    def _shaft(self, x: Floats, y: Floats, z: Floats) -> Floats:
        below = self.plateau - x
        taper = smooth_step((below + 6) / 62)
        half_width = 0.5 * (self.anatomy.epicondylar_width_mm - 3) * (1 - taper) + 0.5 * TIBIA_WIDTH * taper
        front, back = 22 * (1 - taper) + 20 * taper, -30 * (1 - taper) - 8 * taper
        half_depth, middle = 0.5 * (front - back), 0.5 * (front + back)
        level = ((np.abs(y) / half_width) ** 2.3 + (np.abs(z - middle) / half_depth) ** 2.3 + 1e-12) ** (1 / 2.3)
        eminence = 5 * np.exp(-((y / 7) ** 2) - ((z + 6) / 11) ** 2)
        hollow = 1.5 * np.exp(-(((np.abs(y) - 21) / 11) ** 2) - ((z + 6) / 15) ** 2)
        round_about = np.minimum(half_width, half_depth) * (1 - level)
        return smallest(round_about, below + eminence - hollow, TIBIA_LENGTH - below, blend=BLEND)

    def _bump(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """An ellipsoid whose front is the tuberosity."""
        height, aside, before = self.tuberosity
        u, v, w = (x - height + 4) / 26, (y - aside) / TUBEROSITY_HALF_WIDTH, (z - before + 11) / 11
        return 11 * (1 - np.sqrt(u * u + v * v + w * w + 1e-12))
