"""Mesh topology: orientation, edges, connected parts, boundary loops, degenerate and duplicate triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import COINCIDENT, SurfaceMesh


def directed_edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices (3 m, 2) of the triangles' edges, in the triangles' orientation."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def check_winding(mesh: SurfaceMesh, repair: bool) -> SurfaceMesh:
    """Raises InputError if orientations clash or a closed mesh faces inward; `repair` reorients where possible."""
    turned, one_sided, clashes = agreement(mesh.faces)
    if one_sided.any():
        raise InputError(
            f"{clashes} pairs of adjacent triangles face opposite sides, and no choice of sides makes all agree",
            where=mesh.source,
            expected="a surface with two sides, at most two triangles on an edge",
            remedy="pftwin doctor-mesh says where; remove non-manifold edges and overlapping sheets in a mesh editor",
        )
    if not turned.any() and not (mesh.is_closed and mesh.volume < 0):
        return mesh
    if repair:
        agreed = SurfaceMesh(mesh.vertices, turned_over(mesh.faces, turned), mesh.source)
        return agreed.flipped() if agreed.is_closed and agreed.volume < 0 else agreed
    if turned.any():
        raise InputError(
            f"mixed normals: {turned.sum()} of {len(turned)} triangles face the other side than their neighbours",
            where=mesh.source,
            remedy="load_mesh(..., repair=True), or re-orient the faces in a mesh editor and export again",
        )
    raise InputError(
        f"flipped normals: the mesh is closed and its normals point inward (volume {mesh.volume * 1e6:.3g} cm^3)",
        where=mesh.source,
        remedy="load_mesh(..., repair=True), or invert the faces' orientation in a mesh editor",
    )


def turned_over(faces: NDArray[np.int64], which: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Faces (m, 3) with the orientation of those in `which` (m,) reversed."""
    return np.where(which[:, None], faces[:, ::-1], faces)


def adjacent(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Pairs of triangles with a common edge, (k,) each, and whether their orientations clash (same edge direction)."""
    n = len(faces)
    directed = directed_edges(faces)
    key = np.sort(directed, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    same = np.flatnonzero((key[order][1:] == key[order][:-1]).all(axis=1))
    e, o = order[same], order[same + 1]
    return e % n, o % n, directed[e, 0] == directed[o, 0]


def agreement(faces: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """The fewest triangles to reverse for a consistent orientation (m,); triangles of non-orientable parts (m,); and
    the number of adjacent pairs with clashing orientations.

    Two-colouring by the graph's double cover: each triangle has two nodes, unchanged and reversed, and each common edge
    links the nodes that agree. A triangle whose two nodes are connected belongs to a non-orientable surface.
    """
    n = len(faces)
    a, b, clash = adjacent(faces)
    if not clash.any():
        return np.zeros(n, dtype=bool), np.zeros(n, dtype=bool), 0
    rows, columns = np.r_[a, a + n], np.where(np.r_[clash, clash], np.r_[b + n, b], np.r_[b, b + n])
    unchanged, turned = _components(rows, columns, 2 * n).reshape(2, n)
    # A part's two copies are two components: take the one in which fewer of its triangles are reversed.
    sizes = np.bincount(unchanged, minlength=2 * n)
    fewer = (sizes[unchanged] < sizes[turned]) | ((sizes[unchanged] == sizes[turned]) & (unchanged > turned))
    one_sided = unchanged == turned
    return fewer & ~one_sided, one_sided, int(clash.sum())


def _components(a: NDArray[np.int64], b: NDArray[np.int64], n: int) -> NDArray[np.int32]:
    """Labels (n,) of the connected components of a graph with edges (k,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    return connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[1]


HOLE = 0.5  # share of a part's size: a shorter boundary loop is a hole, a longer one the rim of an open surface


class BoundaryLoop(NamedTuple):
    """Connected boundary edges, which border one triangle each."""

    n_edges: int
    length: float
    center: NDArray[np.float64]  # (3,)
    is_hole: bool  # shorter than `HOLE` times the part's size


class MeshPart(NamedTuple):
    """Triangles connected by common edges; lengths in the mesh's unit."""

    faces: NDArray[np.int64]  # (k,) indices of the triangles
    area: float
    size: float  # diagonal of the bounding box
    center: NDArray[np.float64]  # (3,) of the bounding box
    loops: tuple[BoundaryLoop, ...]  # longest first; empty if the part is closed
    volume: float  # enclosed; meaningful only if the part is closed


class Edges(NamedTuple):
    """The edges of a mesh."""

    corners: NDArray[np.int64]  # (e, 2) vertices, ascending
    count: NDArray[np.int64]  # (e,) triangles on each edge: 1 on the boundary, 2 inside a surface
    of_face: NDArray[np.int64]  # (m, 3) edges of each triangle


def edges_of(faces: NDArray[np.int64]) -> Edges:
    """The undirected edges of faces (m, 3), each once."""
    every = np.sort(directed_edges(faces), axis=1)
    corners, of_face, count = np.unique(every, axis=0, return_inverse=True, return_counts=True)
    return Edges(corners, count, of_face.reshape(3, -1).T)


def parts_of(mesh: SurfaceMesh) -> list[MeshPart]:
    """The connected parts, largest area first."""
    a, b, _ = adjacent(mesh.faces)
    label = _components(a, b, len(mesh.faces))
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    edges = edges_of(mesh.faces)
    return sorted((_part_properties(mesh, edges, group) for group in groups), key=lambda part: -part.area)


def _part_properties(mesh: SurfaceMesh, edges: Edges, group: NDArray[np.int64]) -> MeshPart:
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
    """Groups boundary edges (k, 2) into connected loops; loops that touch in a vertex count as one."""
    if not len(boundary):
        return ()
    names, ends = np.unique(boundary, return_inverse=True)
    ends = ends.reshape(-1, 2)
    label = _components(ends[:, 0], ends[:, 1], len(names))
    p = mesh.vertices[boundary]
    lengths, centers = np.linalg.norm(p[:, 1] - p[:, 0], axis=1), p.mean(axis=1)
    loops = []
    for k in range(label.max() + 1):
        own = label[ends[:, 0]] == k
        length = float(lengths[own].sum())
        loops.append(BoundaryLoop(int(own.sum()), length, centers[own].mean(axis=0), length < HOLE * size))
    return tuple(sorted(loops, key=lambda loop: -loop.length))


def zero_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which triangles are degenerate, (m,): their height over the longest side is within `COINCIDENT` of the size."""
    p = vertices[faces]
    sides = np.roll(p, -1, axis=1) - p
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    extent = float(np.ptp(p.reshape(-1, 3), axis=0).max())
    return twice <= COINCIDENT * extent * longest


def repeated(faces: NDArray[np.int64], candidates: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Among the triangles `candidates` (m,): copies of an earlier one with its orientation, (m,), and triangles of
    which there is a copy with the opposite orientation, (m,)."""
    first = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)  # smallest vertex first
    places = np.flatnonzero(candidates)
    copies, opposed = np.zeros((2, len(faces)), dtype=bool)
    _, at, group = np.unique(turned[places], axis=0, return_index=True, return_inverse=True)
    copies[places] = at[group.ravel()] != np.arange(len(places))
    once = places[~copies[places]]
    _, sheet, count = np.unique(np.sort(turned[once], axis=1), axis=0, return_inverse=True, return_counts=True)
    opposed[once] = count[sheet.ravel()] > 1
    return copies, opposed
