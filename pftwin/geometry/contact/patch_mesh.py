"""A mesh prepared for contact with spheres: its facets, their border, and sums over the tree's nodes.

Each facet of a groove, medial and lateral, has a point nearest to a sphere's centre. If it is on the seam and the other
facet is nearer, it is not a separate contact but the slope towards the other facet. A centre beyond the rim of an open
mesh is outside, whichever way the last triangle faces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.wide import BallListLengths, NearestTriangle, WideTree, nearest_wide, wide_tree
from pftwin.geometry.contact.ball_cut import edge_in_ball
from pftwin.geometry.contact.contact_mesh import border_edges, facet_tree
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.region import TrochlearRegion

CHUNK = 64  # triangles cut at a time
DEEPEST = 0.05  # indentation, as a share of the radius, up to which lists suffice for two facets at once
ALONG = 2.2  # triangles cut by an outline, per length of a triangle's side: measured 1.7 to 1.9


class PatchMesh(eqx.Module):
    """A mesh prepared for contact with spheres. Arrays are leaves."""

    facets: MeshFacets
    seam: Array  # (k, 6) edges between the facets [m]
    rim: Array  # (r, 6) edges of an open mesh's boundary [m]
    room: BallListLengths = eqx.field(static=True)  # capacities
    sums: Array | None = None  # (nodes, 10), see `prepared`

    def prepared(self) -> PatchMesh:
        """The same mesh with sums over the tree's nodes; make it once, before many evaluations."""
        values = jnp.where(self.facets.empty[:, None], 0.0, _sums_of(self.facets.triangles))
        lateral = jnp.asarray(self.facets.wide.lateral() * (self.facets.count > 1), values.dtype)
        sums = jnp.concatenate([self.facets.wide.node_sums(values), lateral[:, None]], axis=1)
        return eqx.tree_at(lambda m: m.sums, self, sums, is_leaf=lambda x: x is None)

    def depth_by_distance(self, center: Vec3, radius: Scalar) -> tuple[Scalar, Scalar]:
        """Radius less the signed distance of a sphere's centre to the nearer facet; NaN for the other facet [m]."""
        distances = [p.distance for p in self.facets.points(center)]
        nothing = jnp.full_like(radius, jnp.nan)
        if len(distances) == 1:
            return radius - distances[0], nothing
        medial = jnp.abs(distances[0]) <= jnp.abs(distances[1])
        return (
            jnp.where(medial, radius - distances[0], nothing),
            jnp.where(medial, nothing, radius - distances[1]),
        )

    def rim_inside(self, center: Vec3, radius: Scalar) -> Scalar:
        """Length of the mesh's rim inside a sphere [m]."""
        return seam_depth(self.rim, center, radius).length


def patch_mesh(mesh: SurfaceMesh, radius: float, lateral: ArrayLike | None = None) -> PatchMesh:
    """Prepares a mesh for contact with spheres.

    Args:
        mesh: in the femur's frame, normals outward [m].
        radius: of the sphere, which determines the lists' capacities [m].
        lateral: which triangles are on the lateral facet, (m,) bool (`lateral_of_groove`); None: a single facet.

    Raises:
        InputError: a radius that is not positive; labels that do not match the mesh, or a facet without triangles.
    """
    if not (np.isfinite(radius) and radius > 0):
        raise InputError(f"found {radius}", where="radius", expected="a positive length")
    facets = mesh_facets(mesh, lateral)
    label = np.zeros(len(mesh.faces), int) if lateral is None else np.asarray(lateral).astype(int)
    # The outline is longest at the deepest indentation of a plane.
    outline = 2 * np.pi * radius * np.sqrt(2 * DEEPEST) * facets.count
    side = np.sqrt(np.quantile(mesh.face_areas, 0.25))
    cut = CHUNK * int(np.ceil(min(max(ALONG * outline / side, 2 * CHUNK), len(mesh.faces)) / CHUNK))
    seam, rim = (jnp.asarray(edges, facets.triangles.dtype) for edges in border_edges(mesh, label))
    return PatchMesh(facets, seam, rim, BallListLengths(cut, cut + 1))


def _sums_of(rows: Array) -> Array:
    """Area, first moment, second moment, area vector and flux of the position (n, 9) of triangles (n, 9)."""
    t = Triangle.of_rows(rows)
    n = 0.5 * t.area_vector()
    area, middle = n.norm(), t.a + t.b + t.c
    square = sum((p.squared_norm() for p in (t.a, t.b, t.c)), start=middle.squared_norm())
    m = (area / 3) * middle
    return jnp.stack([area, m.x, m.y, m.z, (area / 12) * square, n.x, n.y, n.z, n.dot(t.a)], axis=1)


# The depth of the facets' border inside a ball shows whether two contacts have merged. If one contact lies across the
# border, the depth along it is a parabola of height d over a chord. The integral of its square over that of the depth
# is 4/5 d for any chord length, and smooth where the chord appears.


# Gauss-Legendre nodes and weights, three points: exact for the polynomials here, of degree four at most.
_NODES = ((-math.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.6), 5 / 18))


class SeamDepth(NamedTuple):
    """Integrals along the part of a chain of edges inside a ball, and their slopes with respect to its centre."""

    length: Scalar  # [m]
    depth: Scalar  # integral of the depth [m^2]
    square: Scalar  # integral of its square [m^3]
    depth_slope: Vec3  # gradient of `depth` [m]
    square_slope: Vec3  # gradient of `square` [m^2]


def seam_depth(edges: Array, center: Vec3, radius: Scalar) -> SeamDepth:
    """Integrals along edges (n, 6), start and end, inside a ball; all in one frame [m]."""
    q = Vec3(*(edges[:, i] - c for i, c in enumerate((center.x, center.y, center.z))))
    way = Vec3(*(edges[:, 3 + i] - edges[:, i] for i in range(3)))
    length, _, _, enter, leave = edge_in_ball(q, way, radius)
    size = (leave - enter) * safe_sqrt(length)
    depth, square = jnp.zeros_like(size), jnp.zeros_like(size)
    depth_slope = square_slope = Vec3(*[jnp.zeros_like(size)] * 3)
    for node, share in _NODES:
        p = q + (0.5 * (enter + leave + node * (leave - enter))) * way
        d, weight = (radius * radius - p.squared_norm()) * (0.5 / radius), share * size
        depth, square = depth + weight * d, square + weight * d * d
        depth_slope = depth_slope + (weight / radius) * p
        square_slope = square_slope + (2 * weight * d / radius) * p
    return SeamDepth(size.sum(), depth.sum(), square.sum(), depth_slope.sum(), square_slope.sum())


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
    """Divides a mesh into its facets and builds their tree; arguments and errors are as in `patch_mesh`."""
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
