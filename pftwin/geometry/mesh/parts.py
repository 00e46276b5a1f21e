"""What a mesh consists of: its connected parts, their boundary loops, and the edges where it is no surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.mesh.winding import adjacent, directed_edges

HOLE = 0.5  # of a part's size: a loop whose length is below that is a hole, a longer one a rim of an open surface


class BoundaryLoop(NamedTuple):
    """Edges with a triangle on one side only, connected with each other."""

    n_edges: int
    length: float
    center: NDArray[np.float64]  # (3,)
    is_hole: bool  # short for its part: a gap rather than the rim of an open surface


class MeshPart(NamedTuple):
    """Triangles connected over common edges."""

    faces: NDArray[np.int64]  # (k,) which triangles
    area: float
    size: float  # diagonal of the bounding box
    center: NDArray[np.float64]  # (3,) of the bounding box
    loops: tuple[BoundaryLoop, ...]  # longest first; none where the part is closed
    volume: float  # enclosed, where the part is closed


class Edges(NamedTuple):
    """The edges of a mesh."""

    corners: NDArray[np.int64]  # (e, 2) vertices, ascending
    count: NDArray[np.int64]  # (e,) triangles on each: 1 on the boundary, 2 inside a surface
    of_face: NDArray[np.int64]  # (m, 3) each triangle's


def edges_of(faces: NDArray[np.int64]) -> Edges:
    """Every edge once."""
    every = np.sort(directed_edges(faces), axis=1)
    corners, of_face, count = np.unique(every, axis=0, return_inverse=True, return_counts=True)
    return Edges(corners, count, of_face.reshape(3, -1).T)


def parts_of(mesh: SurfaceMesh) -> list[MeshPart]:
    """The connected parts, largest area first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(mesh.faces)
    a, b, _ = adjacent(mesh.faces)
    label = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[1]
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    edges = edges_of(mesh.faces)
    return sorted((_part(mesh, edges, group) for group in groups), key=lambda part: -part.area)


def _part(mesh: SurfaceMesh, edges: Edges, group: NDArray[np.int64]) -> MeshPart:
    corners = mesh.vertices[np.unique(mesh.faces[group])]
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float(np.linalg.norm(high - low))
    own = edges.of_face[group].ravel()
    loops = _loops(mesh, edges.corners[own[edges.count[own] == 1]], size)
    middle = 0.5 * (low + high)
    at = mesh.vertices[mesh.faces[group]].mean(axis=1) - middle
    volume = float(np.einsum("ij,ij->", at, mesh.area_vectors[group]) / 3)
    return MeshPart(group, float(mesh.face_areas[group].sum()), size, middle, loops, volume)


def _loops(mesh: SurfaceMesh, boundary: NDArray[np.int64], size: float) -> tuple[BoundaryLoop, ...]:
    """Boundary edges (k, 2) by connection; loops that touch in a vertex count as one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(boundary):
        return ()
    names, ends = np.unique(boundary, return_inverse=True)
    ends = ends.reshape(-1, 2)
    shape = (len(names), len(names))
    n_loops, label = connected_components(coo_array((np.ones(len(ends)), ends.T), shape=shape), directed=False)
    p = mesh.vertices[boundary]
    lengths, centers = np.linalg.norm(p[:, 1] - p[:, 0], axis=1), p.mean(axis=1)
    loops = []
    for k in range(n_loops):
        own = label[ends[:, 0]] == k
        length = float(lengths[own].sum())
        loops.append(BoundaryLoop(int(own.sum()), length, centers[own].mean(axis=0), length < HOLE * size))
    return tuple(sorted(loops, key=lambda loop: -loop.length))
