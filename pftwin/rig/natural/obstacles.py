"""Obstacles on the femur over which lines of force of a natural knee wrap, fitted to the surface of its anatomy.

The medial and the lateral patellofemoral ligament each run over an ellipsoid fitted to the side of their condyle, the
quadriceps over cylinders about the trochlear axis.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from pftwin.base.arrays import Floats
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.tibiofemoral import FemurShape
from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid

# Rays by which a condyle's surface is found: around the trochlear axis, from proximal of anterior to distal, and
# towards the side [deg]; they leave from a point behind that axis, aside by a share of the half width.
AROUND, ASIDE = (-15.0, 100.0, 14), (5.0, 80.0, 11)
BEHIND, CENTRE_ASIDE = 4.0, 0.4  # [mm], [-]
RAY_LENGTH = 60.0  # of the rays [mm]
GAP = 0.4  # by which an ellipsoid stays within the epicondyle, where ligaments begin [mm]
# Of an ellipsoid: centre's height, its distance aside as a share of the half width, its z; radii along x and z.
FIRST = (-1.0, 0.4, -3.0, 28.0, 32.0)
LOW, HIGH = (-15.0, 0.05, -15.0, 15.0, 15.0), (15.0, 0.8, 10.0, 50.0, 60.0)


def beside_condyle(anatomy: Anatomy, side: int) -> Ellipsoid:
    """Fits an ellipsoid to the medial (`side` -1) or lateral (1) condyle between trochlea and epicondyle.

    Its axes are the femur's. Sideways it ends `GAP` within the epicondyle, so that a point on that is outside.
    """
    points = _surface(anatomy, side)
    half = 0.5 * anatomy.epicondylar_width_mm

    def ellipsoid(numbers: Floats) -> tuple[Floats, Floats]:
        x, share, z, along_x, along_z = numbers
        return np.array([x, side * share * half, z]), np.array([along_x, (1 - share) * half - GAP, along_z])

    def distance(numbers: Floats) -> Floats:
        """Distances of the points from the ellipsoid, to first order [mm]."""
        center, radii = ellipsoid(numbers)
        scaled = (points - center) / radii
        size = np.linalg.norm(scaled, axis=1)
        return (size - 1) * size / np.linalg.norm(scaled / radii, axis=1)

    center, radii = ellipsoid(least_squares(distance, FIRST, bounds=(LOW, HIGH)).x)
    return Ellipsoid(vector(1e-3 * center), "femur", vector(1e-3 * radii), Quaternion.identity())


def over_trochlea(anatomy: Anatomy) -> Cylinder:
    """Returns cylinders for the four quadriceps muscles, in the order of `placing.QUADRICEPS`.

    Those of vastus medialis and lateralis reach to their ridge of the trochlea, the others to the groove.
    """
    above = np.array([anatomy.medial_height_mm, anatomy.lateral_height_mm, 0.0, 0.0])
    radius = number(1e-3 * (anatomy.trochlear_radius_mm + above))
    return Cylinder(vector((0.0, 0.0, 0.0)), "femur", radius, vector((0.0, 1.0, 0.0)))


def _surface(anatomy: Anatomy, side: int) -> Floats:
    """Returns the points (n, 3) where the rays leave the femur [mm]."""
    body = FemurShape(anatomy)
    around, aside = np.meshgrid(*(np.radians(np.linspace(*grid)) for grid in (AROUND, ASIDE)), indexing="ij")
    across = np.cos(aside)
    way = np.stack([-np.sin(around) * across, side * np.sin(aside), np.cos(around) * across], axis=-1).reshape(-1, 3)
    start = np.array([0.0, side * CENTRE_ASIDE * 0.5 * anatomy.epicondylar_width_mm, -BEHIND])
    steps = np.arange(0.0, RAY_LENGTH, 0.5)
    inside = body((start + steps[:, None, None] * way).reshape(-1, 3)).reshape(len(steps), -1) > 0
    low = steps[len(steps) - 1 - np.argmax(inside[::-1], axis=0)]
    high = low + steps[1]
    for _ in range(12):  # to a micrometre
        middle = 0.5 * (low + high)
        within = body(start + middle[:, None] * way) > 0
        low, high = np.where(within, middle, low), np.where(within, high, middle)
    return start + low[:, None] * way
