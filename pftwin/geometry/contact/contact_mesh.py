"""A mesh prepared for contact with another mesh: its tree, outward normals at its corners, and its facets.

The medial and lateral facets of a groove are the two subtrees of one root, so a triangle's place gives its facet.
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
        lateral: which triangles are on the lateral facet, (m,) bool (see `mesh_facets.lateral_of_groove`);
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

    Returns:
        The tree; the index of the mesh's triangle in each place (places,); the triangles' features; number of facets.

    Raises:
        InputError: labels that do not match the mesh, or a facet without triangles.
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
