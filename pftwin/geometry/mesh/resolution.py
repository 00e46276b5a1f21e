"""Mesh resolutions: the paper's two by name, and meshes of the implant and the button in them.

Michaud et al. 2024 compare a coarse mesh (CM: deviation 0.1 mm, angle 1 deg) and a fine one (FM: 0.006 mm, 0.5 deg).
What the angle is between is not said there, and whatever it is, it cannot have governed: a button whose neighbouring
triangles turn by 1 deg deviates by a fiftieth of 0.1 mm. The paper's own times tell what did: a step took 27 times as
long with FM as with CM; meshes of those deviations differ 17-fold in triangles, of those angles 4-fold. So CM and FM
are what the deviations ask for. "CM-angle" and "FM-angle" keep to both: the angle is that by which the surface turns
from one grid line to the next (see `FemoralComponent.mesh`), on a sphere that between neighbouring triangles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.icosphere import icosphere, icosphere_deviation
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.implant import FemoralComponent, rig_implant

_DEG = math.pi / 180
_MOST_FREQUENCY = 300  # 1.8 million triangles


class Resolution(NamedTuple):
    """The allowed deviation of a mesh from the surface."""

    deviation: float  # [m]
    angle: float | None = None  # [rad]; None: the deviation alone governs


RESOLUTIONS = {
    "CM": Resolution(0.1e-3),
    "FM": Resolution(0.006e-3),
    "CM-angle": Resolution(0.1e-3, 1 * _DEG),
    "FM-angle": Resolution(0.006e-3, 0.5 * _DEG),
}


def resolution(name: str) -> Resolution:
    """The paper's resolution of that name.

    Raises:
        InputError: no such name.
    """
    found = {k.lower(): fineness for k, fineness in RESOLUTIONS.items()}.get(name.lower())
    if found is None:
        raise InputError(f"no mesh {name!r}", where="resolution", expected=f"one of {', '.join(RESOLUTIONS)}")
    return found


def implant_mesh(fineness: Resolution, component: FemoralComponent | None = None) -> SurfaceMesh:
    """A femoral component (the rig's if None) meshed to a resolution."""
    part = rig_implant() if component is None else component
    return part.mesh(deviation=fineness.deviation, angle=fineness.angle)


def button_mesh(radius: float, fineness: Resolution) -> SurfaceMesh:
    """The coarsest icosphere that keeps to a resolution; its middle is the origin.

    Raises:
        InputError: a radius or tolerances that are not positive, or ask for more triangles than a mesh may have.
    """
    deviation, angle = fineness
    for name, value in (("radius", radius), ("deviation", deviation), ("angle", 1.0 if angle is None else angle)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"found {value}", where=name, expected="a positive number")
    # First guess from a hexagonal net on the sphere, then corrected by the icosphere's own deviation.
    frequency = max(1, math.floor(0.5 * math.sqrt(radius / deviation)))
    if angle is not None:
        frequency = max(frequency, math.floor(0.5 / angle))
    while frequency <= _MOST_FREQUENCY:
        found = icosphere_deviation(frequency)
        if radius * found.deviation <= deviation and (angle is None or found.angle <= angle):
            return icosphere(radius, frequency)
        frequency += 1
    raise InputError(
        f"more than {20 * _MOST_FREQUENCY**2} triangles", where="deviation, angle", remedy="coarser tolerances"
    )


def button_of_like_size(radius: float, mesh: SurfaceMesh) -> SurfaceMesh:
    """The icosphere whose triangles have about the mean area of another mesh's."""
    share = 4 * math.pi * radius**2 / (mesh.area / len(mesh.faces))
    return icosphere(radius, max(1, round(math.sqrt(share / 20))))
