"""A mesh prepared for contact with another mesh: its tree, outward normals at its corners, and its facets.

The medial and lateral facets of a groove are the two subtrees of one root, so a triangle's place gives its facet.

The seven features of a triangle are numbered as in `pftwin.geometry.bvh.triangle`. An edge's normal is the mean of its
two triangles' normals, a corner's the angle-weighted mean of its triangles' normals: with these the sign of the
distance at the nearest point is always right (Baerentzen and Aanaes 2005).
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.geometry.bvh.corners import CornerTree, corner_tree
from pftwin.geometry.bvh.pairs import LEAF
from pftwin.geometry.bvh.tree import MeshTree, build_tree, depth_for, joined_tree
from pftwin.geometry.mesh.mesh import SurfaceMesh, summed_at
from pftwin.geometry.mesh.topology import Edges, edges_of

_PER_EDGE = 9  # points of each edge of a border from which distances are measured


class ContactMesh(eqx.Module):
    """A mesh prepared for contact with another mesh. Arrays are leaves."""

    tree: MeshTree
    source: Array  # (places,) int32: index of the mesh's triangle in each place of the tree
    corners: CornerTree  # of the vertices
    seam: Array  # (places,) int8: bits 1, 2, 4 for an edge ab, bc, ca on the border of two facets
    rim: Array  # (places,) int8: the same for an edge on the rim of an open mesh
    facets: int = eqx.field(static=True)  # number: 1, or 2 (medial and lateral)

    def facet(self, place: Array) -> Array:
        """Facet, 0 or 1, of the triangle in a place, int32."""
        if self.facets == 1:
            return jnp.zeros_like(place)
        return place // (LEAF << (self.tree.depth - 1))


def contact_mesh(mesh: SurfaceMesh, lateral: ArrayLike | None = None) -> ContactMesh:
    """Prepares a mesh for contact with another mesh.

    Args:
        mesh: in its body's frame, normals outward [m].
        lateral: which triangles are on the lateral facet, (m,) bool (see `patch_mesh.lateral_of_groove`);
            None: a single facet.

    Raises:
        InputError: labels that do not match the mesh, or a facet without triangles.
    """
    tree, source, features, facets = facet_tree(mesh, lateral, leaf=LEAF, least_depth=2)
    marked = (features.seam, features.rim)
    seam, rim = ((x[source][:, 1:4] * np.array([1, 2, 4])).sum(axis=1).astype(np.int8) for x in marked)
    normals = np.zeros_like(mesh.vertices)  # outward, angle-weighted
    normals[mesh.faces] = features.outward[:, 4:]
    source, seam, rim = jax.device_put((source.astype(np.int32), seam, rim))
    return ContactMesh(tree, source, corner_tree(mesh.vertices, normals), seam, rim, facets)


def facet_tree(
    mesh: SurfaceMesh, lateral: ArrayLike | None, *, leaf: int, least_depth: int
) -> tuple[MeshTree, NDArray[np.int64], Features, int]:
    """Builds the tree of a mesh; `lateral` (m,) bool marks the lateral facet, each facet is a subtree of the root.

    Returns the tree, the index of the mesh's triangle in each place (places,), the triangles' features, and the number
    of facets. Raises InputError for labels that do not match the mesh, or a facet without triangles.
    """
    m = len(mesh.faces)
    label = np.zeros(m, dtype=np.int64) if lateral is None else np.asarray(lateral).astype(np.int64)
    if label.shape != (m,):
        raise InputError(f"labels of shape {label.shape}", where="lateral", expected=f"one for each triangle, ({m},)")
    groups = [np.flatnonzero(label == k) for k in range(1 if lateral is None else 2)]
    if not all(g.size for g in groups):
        side = "medial" if not groups[0].size else "lateral"
        raise InputError(f"no triangle is {side}", where=mesh.source, remedy="check the groove line against the mesh")
    depth = max(least_depth, *(depth_for(len(g), leaf) for g in groups))
    parts = [SurfaceMesh(mesh.vertices, mesh.faces[g], mesh.source) for g in groups]
    trees = [build_tree(part, leaf=leaf, depth=depth) for part in parts]
    source = np.concatenate([g[np.asarray(t.source_index())] for g, t in zip(groups, trees, strict=True)])
    return joined_tree(trees), source, features_of(mesh, label), len(groups)


class Features(NamedTuple):
    """Properties of each triangle's face, three edges and three corners, in this order."""

    outward: NDArray[np.float64]  # (m, 7, 3) unit outward pseudo-normals
    rim: NDArray[np.bool_]  # (m, 7) on the boundary of an open mesh
    seam: NDArray[np.bool_]  # (m, 7) shared with a triangle of another label


def features_of(mesh: SurfaceMesh, label: NDArray[np.int64]) -> Features:
    """Computes the features of a mesh; `label` (m,) holds the facet of each triangle."""
    faces, n = mesh.faces, len(mesh.vertices)
    normals = mesh.area_vectors / np.maximum(mesh.face_areas, 1e-300)[:, None]
    edges = edges_of(faces)
    at_edges = summed_at(edges.of_face, np.repeat(normals, 3, axis=0), len(edges.corners))
    arms = np.roll(mesh.vertices[faces], -1, axis=1) - mesh.vertices[faces]
    arms /= np.maximum(np.linalg.norm(arms, axis=2, keepdims=True), 1e-300)
    angles = np.arccos(np.clip(-np.einsum("nij,nij->ni", arms, np.roll(arms, 1, axis=1)), -1, 1))
    at_corners = summed_at(faces, (angles[:, :, None] * normals[:, None]).reshape(-1, 3), n)
    outward = np.concatenate([normals[:, None], at_edges[edges.of_face], at_corners[faces]], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=2, keepdims=True), 1e-300)
    between = _label_borders(edges, label)
    return Features(outward, *(_marked_features(faces, edges, marked) for marked in (edges.count == 1, between)))


def _marked_features(faces: NDArray, edges: Edges, marked: NDArray) -> NDArray[np.bool_]:
    """Features (m, 7) on marked edges (e,): the edges and their ends, never faces."""
    ends = np.zeros(edges.corners.max() + 1, dtype=bool)
    ends[edges.corners[marked]] = True
    return np.concatenate([np.zeros((len(faces), 1), bool), marked[edges.of_face], ends[faces]], axis=1)


def _label_borders(edges: Edges, label: NDArray) -> NDArray[np.bool_]:
    """Which edges, (e,), have triangles of different labels (m,)."""
    lowest, highest = np.full(len(edges.corners), label.max()), np.full(len(edges.corners), label.min())
    np.minimum.at(lowest, edges.of_face.ravel(), np.repeat(label, 3))
    np.maximum.at(highest, edges.of_face.ravel(), np.repeat(label, 3))
    return lowest < highest


def border_edges(mesh: SurfaceMesh, label: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """End points (k, 6) of the edges between triangles of different labels (m,), and of an open mesh's boundary."""
    edges = edges_of(mesh.faces)
    marked = _label_borders(edges, label), edges.count == 1
    seam, rim = (mesh.vertices[edges.corners[m]].reshape(-1, 6) for m in marked)
    return seam, rim


def distances_from_border(mesh: SurfaceMesh, lateral: NDArray[np.bool_]) -> Floats:
    """Distances (m, 3) of the triangles' corners from the border between the facets, positive on the lateral one [m].

    The border follows edges, so it is known to a triangle's width. Without one, as on a mesh that is one facet or whose
    triangles share no vertices, distances are 1 m.
    """
    from scipy.spatial import cKDTree

    sign = np.where(lateral, 1.0, -1.0)[:, None]
    seam, _ = border_edges(mesh, lateral.astype(np.int64))
    if not len(seam):
        return np.repeat(sign, 3, axis=1)
    share = np.linspace(0.0, 1.0, _PER_EDGE)[:, None, None]
    points = (1.0 - share) * seam[:, :3] + share * seam[:, 3:]
    away = np.asarray(cKDTree(points.reshape(-1, 3)).query(mesh.vertices)[0])
    return sign * away[mesh.faces]
