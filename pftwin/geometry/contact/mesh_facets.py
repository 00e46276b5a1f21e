"""A mesh as its facets, medial and lateral of a groove, each with a tree: what a sphere touches on each of them.

On each facet the sphere has one nearest point. Where that lies on the seam and the other facet is nearer still, it is
no contact of its own but the slope down to the other one. On the rim of an open mesh there is no inside: a centre
beyond it is outside, whichever way the last triangle looks.
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
    distance: Scalar  # to it, negative inside [m]
    normal: Vec3  # unit, out of the bone
    on_seam: Array  # bool: on the border to the other facet
    beyond_rim: Scalar  # how far sideways past the rim of an open mesh the centre lies, 0 elsewhere [m]
    overflow: Array  # bool: the search ran out of room, the point may be wrong


class MeshFacets(eqx.Module):
    """One facet, or two, medial first: two have one tree, each below half of its top. Arrays are leaves."""

    triangles: Array  # (places, 9) corners a, b, c [m], in the tree's order; an empty place holds a copy
    empty: Array  # (places,) bool
    wide: WideTree
    outward: Array  # (places, 7, 3) float32: out at each feature of a triangle
    marks: Array  # (places, 7) int8: 1 on the rim, 2 on the seam
    count: int = eqx.field(static=True)

    def points(self, c: Vec3) -> list[FacetPoint]:
        """The nearest point of each facet to a point of the mesh's frame, with all its derivatives."""
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
    """The facets of a mesh with their trees.

    Args:
        mesh: in the femur's frame, normals outward [m].
        lateral: which triangles are on the lateral facet, (m,) bool (see `lateral_of_groove`); None: there is but one.

    Raises:
        InputError: labels that do not suit the mesh, or leave one facet without triangles.
    """
    tree, which, features, count = facet_tree(mesh, lateral, leaf=1, least_depth=1)
    marks = (_RIM * features.rim[which] + _SEAM * features.seam[which]).astype(np.int8)
    outward = features.outward[which].astype(np.float32)
    empty = np.asarray(tree.index) < 0
    triangles, out, marked = jax.device_put(tree.triangles), jax.device_put(outward), jax.device_put(marks)
    return MeshFacets(triangles, jax.device_put(empty), wide_tree(tree), out, marked, count)


def lateral_of_groove(mesh: SurfaceMesh, region: TrochlearRegion) -> NDArray[np.bool_]:
    """Which triangles lie laterally of a region's groove line (right knee), (m,); its ends go on straight."""
    axes, origin = np.asarray(region.cylinder.axes.array()), np.asarray(region.cylinder.origin.array())
    middles, line = ((p - origin) @ axes for p in (mesh.vertices[mesh.faces].mean(axis=1), region.groove))
    angles, along = (np.arctan2(p[:, 0], p[:, 2]) for p in (middles, line))
    order = np.argsort(along)
    return middles[:, 1] > np.interp(angles, along[order], line[order, 1])
