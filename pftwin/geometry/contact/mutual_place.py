"""How two meshes lie to each other at a pose: how far apart, and how much of one is behind the other. Host side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import SurfaceMesh


class MutualPlace(NamedTuple):
    """To the accuracy of a mesh's vertices."""

    gap: float  # least distance of their vertices [m]
    behind: float  # share of the second's area that is behind the first's surface
    deepest: float  # of its vertices below the plane at the nearest vertex there; 0 where none is [m]


def mutual_place(
    mesh: SurfaceMesh, other: SurfaceMesh, position: NDArray[np.float64], matrix: NDArray[np.float64]
) -> MutualPlace:
    """Look at two meshes.

    Args:
        mesh: whose surface has a back.
        other: looked at, vertex by vertex.
        position, matrix: of the other's frame in the mesh's, (3,) [m] and (3, 3).
    """
    from scipy.spatial import cKDTree

    points = other.vertices @ matrix.T + position
    away, near = cKDTree(mesh.vertices).query(points)
    height = np.einsum("ij,ij->i", points - mesh.vertices[near], mesh.vertex_normals[near])
    share = float(np.average(height < 0, weights=other.vertex_areas))
    return MutualPlace(float(np.min(away)), share, max(0.0, -float(np.min(height))))
