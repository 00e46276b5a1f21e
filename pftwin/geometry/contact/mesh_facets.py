"""A mesh divided into the medial and lateral facets of a groove, and the point of each nearest to a sphere's centre.

If a facet's nearest point is on the seam and the other facet is nearer, it is not a separate contact but the slope
towards the other facet. A centre beyond the rim of an open mesh is outside, whichever way the last triangle faces.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.wide import NearestTriangle, WideTree, nearest_wide, wide_tree
from pftwin.geometry.contact.contact_mesh import facet_tree
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.region import TrochlearRegion

_RIM, _SEAM = 1, 2


class FacetPoint(NamedTuple):
    """The nearest point of one facet."""

    point: Vec3  # mesh frame [m]
    distance: Scalar  # signed distance, negative inside [m]
    normal: Vec3  # unit, out of the bone
    on_seam: Array  # bool: on the border to the other facet
    beyond_rim: Scalar  # lateral distance of the centre beyond the rim of an open mesh, 0 elsewhere [m]
    overflow: Array  # bool: the search exceeded its capacity, the point may be wrong


class MeshFacets(eqx.Module):
    """One or two facets, the medial one first, in one tree: each has half of the places. Arrays are leaves."""

    triangles: Array  # (places, 9) corners a, b, c [m], in the tree's order; an empty place holds a copy
    empty: Array  # (places,) bool
    wide: WideTree
    outward: Array  # (places, 7, 3) float32: outward pseudo-normal at each feature of a triangle
    marks: Array  # (places, 7) int8: bit 1 for a feature on the rim, bit 2 on the seam
    count: int = eqx.field(static=True)  # number of facets

    def points(self, c: Vec3) -> list[FacetPoint]:
        """Nearest point of each facet to a point of the mesh's frame [m]; differentiable."""
        halves = (None,) if self.count == 1 else (0, 1)
        return [self._point(nearest_wide(self.wide, self.triangles, c, half), c) for half in halves]

    def _point(self, near: NearestTriangle, c: Vec3) -> FacetPoint:
        on = closest_on_triangle(Triangle.of_rows(self.triangles[near.place]), c)
        away = c - on.point
        length = away.norm()
        out = Vec3.from_array(jax.lax.convert_element_type(self.outward[near.place, on.feature], length.dtype))
        mark = self.marks[near.place, on.feature]
        rim = (mark & _RIM) > 0
        inside = ~rim & (stop_gradient(away).dot(out) < 0)
        sign = jnp.where(inside, -1.0, 1.0)
        touching = length > 0
        over = sign / jnp.where(touching, length, 1.0)
        normal = jax.tree.map(lambda a, o: jnp.where(touching, over * a, o), away, out)
        face = Vec3.from_array(jax.lax.convert_element_type(self.outward[near.place, 0], length.dtype))
        beside = away - away.dot(face) * face
        return FacetPoint(
            on.point,
            sign * length,
            normal,
            (mark & _SEAM) > 0,
            jnp.where(rim, beside.norm(), 0.0),
            near.overflow,
        )


def mesh_facets(mesh: SurfaceMesh, lateral: ArrayLike | None = None) -> MeshFacets:
    """Divides a mesh into its facets and builds their tree.

    Args:
        mesh: in the femur's frame, normals outward [m].
        lateral: which triangles are on the lateral facet, (m,) bool (see `lateral_of_groove`); None: a single facet.

    Raises:
        InputError: labels that do not match the mesh, or a facet without triangles.
    """
    tree, which, features, count = facet_tree(mesh, lateral, leaf=1, least_depth=1)
    marks = (_RIM * features.rim[which] + _SEAM * features.seam[which]).astype(np.int8)
    outward = features.outward[which].astype(np.float32)
    empty = np.asarray(tree.index) < 0
    triangles, out, marked = jax.device_put(tree.triangles), jax.device_put(outward), jax.device_put(marks)
    return MeshFacets(triangles, jax.device_put(empty), wide_tree(tree), out, marked, count)


def lateral_of_groove(mesh: SurfaceMesh, region: TrochlearRegion) -> NDArray[np.bool_]:
    """Which triangles are lateral of a region's groove line (right knee), (m,); its ends are extended straight."""
    axes, origin = np.asarray(region.cylinder.axes.array()), np.asarray(region.cylinder.origin.array())
    middles, line = ((p - origin) @ axes for p in (mesh.vertices[mesh.faces].mean(axis=1), region.groove))
    angles, along = (np.arctan2(p[:, 0], p[:, 2]) for p in (middles, line))
    order = np.argsort(along)
    return middles[:, 1] > np.interp(angles, along[order], line[order, 1])
