"""Tests whether a point is behind a surface, by the signed solid angle that the surface subtends at the point.

As a share of the full sphere (winding number) it is 1 inside a closed mesh and 0 outside; in front of an open mesh it
is negative; close behind an open mesh it is 1/2 and tends to 0 with the distance. There the nearest point decides: the
point is behind if that is not on the rim, since beyond the rim there is neither front nor back. The solid angle of a
triangle is that of van Oosterom and Strackee 1983, IEEE Trans Biomed Eng 30:125. The test visits every triangle, so it
is used only for results, and only where nothing touches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh.loops import member_by_member
from pftwin.geometry.bvh.triangle import FACE, Triangle, closest_on_triangle
from pftwin.geometry.mesh.mesh import SurfaceMesh

SHARE = 0.25  # share of the full solid angle above which a point is behind: half of that close behind a plane
SEEN = 1e-3  # share of the full solid angle below which a point is not behind: rounding, or too far away
SAME = 1e-6  # relative difference of squared distances up to which triangles are equally near
_EDGES = (0, 1, 2, 4, 1 | 4, 1 | 2, 2 | 4)  # bits of the edges that each feature of a triangle lies on


class Behind(NamedTuple):
    """Whether a point is behind a surface; the other fields are valid only if it is."""

    there: Array  # () bool: behind the surface
    depth: Scalar  # distance to the surface's nearest point [m]
    place: Array  # () int32: place of the nearest triangle


def behind(corners: Array, triangle: Array, rim: Array, p: Vec3, wanted: Array) -> Behind:
    """Tests whether a point is behind a surface.

    It is if the surface subtends more than `SHARE` of the full solid angle, or more than `SEEN` with a nearest point
    that is not on the rim.

    Args:
        corners: of the triangles, (places, 9) [m]; copies are allowed.
        triangle: (places,) int32, index of each triangle, less than the number of places.
        rim: (places,) integers, bits 1, 2, 4 if the edge ab, bc, ca is on the rim of an open mesh.
        p: the point, same frame [m].
        wanted: () bool; if false, nothing is computed and the result is "not behind".

    Not differentiated.
    """

    def look(corners: Array, triangle: Array, rim: Array, p: Vec3, wanted: Array) -> Behind:
        nothing = jnp.zeros_like(p.x)
        share = jax.lax.cond(wanted, lambda: _back_solid_angle(corners, triangle, p), lambda: nothing)
        nowhere = Behind(jnp.asarray(False), nothing, jnp.zeros((), jnp.int32))
        return jax.lax.cond(share > SEEN, lambda: _below_surface(corners, rim, p, share > SHARE), lambda: nowhere)

    return member_by_member(look)(corners, triangle, rim, p, wanted)


def _below_surface(corners: Array, rim: Array, p: Vec3, surely: Array) -> Behind:
    """The nearest point; the point is behind if `surely`, or if the nearest point is not on the rim."""
    on = closest_on_triangle(Triangle.of_rows(corners), _repeated(p, corners))
    place = jnp.argmin(on.square).astype(jnp.int32)
    nearest = on.square <= (1 + SAME) * on.square[place]
    at_rim = (rim.astype(jnp.int32) & jnp.asarray(_EDGES, jnp.int32)[on.feature]) > 0
    inside = ~(nearest & (on.feature != FACE) & at_rim).any()
    return Behind(surely | inside, jnp.sqrt(on.square[place]), place)


def _back_solid_angle(corners: Array, triangle: Array, p: Vec3) -> Scalar:
    """Solid angle of the surface at p over 4 pi, positive where p is behind it."""
    t = Triangle.of_rows(corners)
    here = _repeated(p, corners)
    a, b, c = t.a - here, t.b - here, t.c - here
    la, lb, lc = a.norm(), b.norm(), c.norm()
    angle = 2 * jnp.arctan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    once = jnp.zeros_like(angle).at[triangle].set(angle)
    return jnp.sum(once) / (4 * math.pi)


def _repeated(p: Vec3, corners: Array) -> Vec3:
    """The point repeated for each triangle."""
    return Vec3(*(jnp.broadcast_to(x, corners.shape[:1]) for x in (p.x, p.y, p.z)))


class MutualPlace(NamedTuple):
    """Relative position of two meshes, estimated from their vertices."""

    gap: float  # smallest distance between vertices of both [m]
    behind: float  # share of the second mesh's area that is behind the first's surface
    deepest: float  # largest depth of its vertices below the tangent plane at the nearest vertex, or 0 [m]


def mutual_place(
    mesh: SurfaceMesh, other: SurfaceMesh, position: NDArray[np.float64], matrix: NDArray[np.float64]
) -> MutualPlace:
    """Estimates where one mesh is relative to another, tested vertex by vertex; the first defines front and back.

    `position` (3,) [m] and `matrix` (3, 3) are the pose of the second's frame in the first's.
    """
    from scipy.spatial import cKDTree

    points = other.vertices @ matrix.T + position
    away, near = cKDTree(mesh.vertices).query(points)
    height = np.einsum("ij,ij->i", points - mesh.vertices[near], mesh.vertex_normals[near])
    share = float(np.average(height < 0, weights=other.vertex_areas))
    return MutualPlace(float(np.min(away)), share, max(0.0, -float(np.min(height))))
