"""Principal directions of a surface: along which it is longest, and across. Host side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import SurfaceMesh


class PrincipalAxis(NamedTuple):
    """One of three orthogonal directions."""

    direction: NDArray[np.float64]  # (3,) unit
    extent: float  # of the mesh along it [the mesh's unit]


def principal_axes(mesh: SurfaceMesh) -> tuple[PrincipalAxis, ...]:
    """Eigenvectors of the surface's second moment of area about its centroid: right-handed, the longest extent first.

    The largest component of the first two is positive.
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
