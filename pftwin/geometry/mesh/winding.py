"""Which side of each triangle is outside: do the triangles of a mesh agree, and what would make them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import SurfaceMesh


class Agreement(NamedTuple):
    """What it takes for neighbouring triangles to agree on their outside."""

    turned: NDArray[np.bool_]  # (m,) the fewest triangles whose turning makes them agree
    one_sided: NDArray[np.bool_]  # (m,) triangles of parts where no choice does
    clashes: int  # pairs of neighbours that face opposite sides


def directed_edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """(3 m, 2), in the triangles' own sense."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def check_winding(mesh: SurfaceMesh, repair: bool) -> SurfaceMesh:
    """Neighbours must run their common edge in opposite senses; a closed mesh must enclose a positive volume."""
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
    """The faces with some of them turned, (m, 3)."""
    return np.where(which[:, None], faces[:, ::-1], faces)


def adjacent(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Pairs of triangles with a common edge, (k,) each, and whether they run it in the same sense (they should not)."""
    n = len(faces)
    directed = directed_edges(faces)
    key = np.sort(directed, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    same = np.flatnonzero((key[order][1:] == key[order][:-1]).all(axis=1))
    e, o = order[same], order[same + 1]
    return e % n, o % n, directed[e, 0] == directed[o, 0]


def agreement(faces: NDArray[np.int64]) -> Agreement:
    """Which triangles to turn so that neighbours agree.

    Two-colouring by the graph's double cover: every triangle is there twice, kept and turned, and each common edge ties
    the choices that agree; a triangle tied to its own opposite belongs to a surface without two sides.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(faces)
    a, b, clash = adjacent(faces)
    none = np.zeros(n, dtype=bool)
    if not clash.any():
        return Agreement(none, none, 0)
    rows, columns = np.r_[a, a + n], np.where(np.r_[clash, clash], np.r_[b + n, b], np.r_[b, b + n])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * n, 2 * n))
    kept, turned = connected_components(graph, directed=False)[1].reshape(2, n)
    # a body's two copies are two components; keep the copy in which fewer of its triangles are turned
    sizes = np.bincount(kept, minlength=2 * n)
    fewer = (sizes[kept] < sizes[turned]) | ((sizes[kept] == sizes[turned]) & (kept > turned))
    one_sided = kept == turned
    return Agreement(fewer & ~one_sided, one_sided, int(clash.sum()))
