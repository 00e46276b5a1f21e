"""A mesh prepared for contact with another: its tree, outward normals at its corners, and its facets.

Medial and lateral facets of a groove have a tree each, below the two children of one root: which facet a triangle is on
can be read from its place.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.bvh.corners import CornerTree, corner_tree
from pftwin.geometry.bvh.features import Features, features_of
from pftwin.geometry.bvh.pairs import LEAF
from pftwin.geometry.bvh.tree import MeshTree, build_tree, depth_for, joined_tree
from pftwin.geometry.mesh.mesh import SurfaceMesh


class ContactMesh(eqx.Module):
    """A mesh that touches. Arrays are leaves."""

    tree: MeshTree
    source: Array  # (places,) int32: which triangle of the mesh is in each place of the tree
    corners: CornerTree  # the vertices
    seam: Array  # (places,) int8: bits 1, 2, 4 for an edge ab, bc, ca on the border of two facets
    rim: Array  # (places,) int8: the same for an edge of one triangle alone, on the rim of an open mesh
    facets: int = eqx.field(static=True)  # 1, or 2: medial and lateral

    def facet(self, place: Array) -> Array:
        """0 or 1: the facet of the triangle in a place, int32."""
        if self.facets == 1:
            return jnp.zeros_like(place)
        return place // (LEAF << (self.tree.depth - 1))


def contact_mesh(mesh: SurfaceMesh, lateral: ArrayLike | None = None) -> ContactMesh:
    """A mesh ready to touch another.

    Args:
        mesh: in its body's frame, normals outward [m].
        lateral: which triangles are on the lateral facet, (m,) bool (see `mesh_facets.lateral_of_groove`);
            None: all is one facet.

    Raises:
        InputError: labels that do not suit the mesh, or leave one facet without triangles.
    """
    tree, source, features, facets = facet_tree(mesh, lateral, leaf=LEAF, least_depth=2)
    marked = (features.seam, features.rim)
    seam, rim = ((x[source][:, 1:4] * np.array([1, 2, 4])).sum(axis=1).astype(np.int8) for x in marked)
    normals = np.zeros_like(mesh.vertices)  # outward at the vertices, weighted by angles
    normals[mesh.faces] = features.outward[:, 4:]
    source, seam, rim = jax.device_put((source.astype(np.int32), seam, rim))
    return ContactMesh(tree, source, corner_tree(mesh.vertices, normals), seam, rim, facets)


def facet_tree(
    mesh: SurfaceMesh, lateral: ArrayLike | None, *, leaf: int, least_depth: int
) -> tuple[MeshTree, NDArray[np.int64], Features, int]:
    """The tree of a mesh whose triangles are medial, or lateral as (m,) bool says; None: all is one facet.

    Two facets have one tree, each below a child of the root. With which triangle of the mesh is in each place
    (places,), the triangles' features, and the number of facets.

    Raises:
        InputError: labels that do not suit the mesh, or leave one facet without triangles.
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
