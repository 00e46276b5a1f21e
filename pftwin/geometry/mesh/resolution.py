"""Mesh resolutions: the paper's two by name, and meshes of the button in them.

Michaud et al. 2024 compare a coarse mesh (CM: deviation 0.1 mm, angle 1 deg) and a fine one (FM: 0.006 mm, 0.5 deg).
What the angle is between is not said there, and whatever it is, it cannot have governed: a button whose neighbouring
triangles turn by 1 deg deviates by a fiftieth of 0.1 mm. The paper's own times tell what did: a step took 27 times as
long with FM as with CM; meshes of those deviations differ 17-fold in triangles, of those angles 4-fold. So CM and FM
are what the deviations ask for.
"""

from __future__ import annotations

import math

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.icosphere import icosphere, icosphere_deviation
from pftwin.geometry.mesh.mesh import SurfaceMesh

_MOST_FREQUENCY = 300  # 1.8 million triangles

RESOLUTIONS = {"CM": 0.1e-3, "FM": 0.006e-3}  # the allowed deviation of a mesh from the surface [m]


def button_mesh(radius: float, deviation: float) -> SurfaceMesh:
    """The coarsest icosphere that stays within a deviation [m] of the sphere; its middle is the origin.

    Raises:
        InputError: a radius or deviation that is not positive, or asks for more triangles than a mesh may have.
    """
    for name, value in (("radius", radius), ("deviation", deviation)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"found {value}", where=name, expected="a positive number")
    # First guess from a hexagonal net on the sphere, then corrected by the icosphere's own deviation.
    frequency = max(1, math.floor(0.5 * math.sqrt(radius / deviation)))
    while frequency <= _MOST_FREQUENCY:
        if radius * icosphere_deviation(frequency) <= deviation:
            return icosphere(radius, frequency)
        frequency += 1
    raise InputError(f"more than {20 * _MOST_FREQUENCY**2} triangles", where="deviation", remedy="a coarser one")
