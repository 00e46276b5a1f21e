"""Orientation of a mesh in its frame: directions for which a trochlear groove is found, and principal axes."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.written_amounts import AXES
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.region import TrochlearRegion, trochlear_region


class Candidate(NamedTuple):
    """Directions along a mesh's axes, such as "-x", and the region that is found with them."""

    anterior: str
    proximal: str
    region: TrochlearRegion


def directions_with_groove(
    mesh: SurfaceMesh, *, half_width: float = 0.02, angles: tuple[float, float] = (-math.pi / 3, math.pi / 3)
) -> list[Candidate]:
    """All pairs of directions along a mesh's axes, anterior and proximal, with which `trochlear_region` finds a groove.

    Pairs whose groove extends farthest distally come first, as a trochlea's does; then those with the longest groove.
    The shape alone does not determine the right pair: the notch of a bone is a groove too, and so is a trochlea upside
    down.

    Args:
        mesh, half_width, angles: as for `trochlear_region`.
    """
    found = []
    for (anterior, ahead), (proximal, up) in itertools.permutations(AXES.items(), 2):
        if anterior[1] == proximal[1]:
            continue  # the same axis
        try:
            region = trochlear_region(mesh, anterior=ahead, proximal=up, half_width=half_width, angles=angles)
        except InputError:
            continue  # no groove found
        found.append(Candidate(anterior, proximal, region))
    return sorted(found, key=lambda c: (round(c.region.angles[0], 3), -len(c.region.groove)))


class PrincipalAxis(NamedTuple):
    """One of the three principal axes."""

    direction: NDArray[np.float64]  # (3,) unit
    extent: float  # size of the mesh along it [the mesh's unit]


def principal_axes(mesh: SurfaceMesh) -> tuple[PrincipalAxis, ...]:
    """Eigenvectors of the surface's second moment of area about its centroid, right-handed, longest extent first.

    The largest component of each of the first two is positive.
    """
    corners, areas = mesh.vertices[mesh.faces], mesh.face_areas
    arms = corners - np.average(corners.mean(axis=1), axis=0, weights=areas)
    total = arms.sum(axis=1)
    # Exact for flat triangles: the integral of p p^T is area / 12 times this.
    moment = np.einsum("mki,mkj,m->ij", arms, arms, areas) + np.einsum("mi,mj,m->ij", total, total, areas)
    columns = np.linalg.eigh(moment)[1]
    directions = sorted(columns.T, key=lambda d: -np.ptp(mesh.vertices @ d))
    first, second = (d * np.sign(d[np.abs(d).argmax()]) for d in directions[:2])
    return tuple(PrincipalAxis(d, float(np.ptp(mesh.vertices @ d))) for d in (first, second, np.cross(first, second)))
