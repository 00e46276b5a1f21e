"""Which side of each triangle is outside: do the triangles of a mesh agree, and what would make them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.errors import InputError
from pftwin.surfaces.mesh import SurfaceMesh


def directed_edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """(3 m, 2), in the triangles' own sense."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def check_winding(mesh: SurfaceMesh, repair: bool) -> SurfaceMesh:
    """Neighbours must run their common edge in opposite senses; a closed mesh must enclose a positive volume."""
    turned = _turned(mesh)
    if not turned.any() and not (mesh.is_closed and mesh.volume < 0):
        return mesh
    if repair:
        faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
        agreed = SurfaceMesh(mesh.vertices, faces, mesh.source)
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


def _turned(mesh: SurfaceMesh) -> NDArray[np.bool_]:
    """The fewest triangles whose turning makes neighbours agree, (m,).

    Two-colouring by the graph's double cover: every triangle is there twice, kept and turned, and each common edge ties
    the choices that agree; a triangle tied to its own opposite belongs to a surface without two sides.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(mesh.faces)
    directed = directed_edges(mesh.faces)
    key = np.sort(directed, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    same = np.flatnonzero((key[order][1:] == key[order][:-1]).all(axis=1))
    e, o = order[same], order[same + 1]
    clash = directed[e, 0] == directed[o, 0]
    a, b = e % n, o % n
    if not clash.any():
        return np.zeros(n, dtype=bool)
    rows, columns = np.r_[a, a + n], np.where(np.r_[clash, clash], np.r_[b + n, b], np.r_[b, b + n])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * n, 2 * n))
    kept, turned = connected_components(graph, directed=False)[1].reshape(2, n)
    if (kept == turned).any():
        raise InputError(
            f"{clash.sum()} pairs of adjacent triangles face opposite sides, and no choice of sides makes all agree",
            where=mesh.source,
            expected="a surface with two sides, at most two triangles on an edge",
            remedy="repair the mesh in a mesh editor (remove non-manifold edges, overlapping sheets)",
        )
    # a body's two copies are two components; keep the copy in which fewer of its triangles are turned
    sizes = np.bincount(kept, minlength=2 * n)
    return (sizes[kept] < sizes[turned]) | ((sizes[kept] == sizes[turned]) & (kept > turned))
