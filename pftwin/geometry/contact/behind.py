"""Whether a point is behind a surface, and its distance: by the solid angle under which it sees the surface's back.

Inside a closed mesh that is all directions, outside none; in front of an open one it is negative. Close behind an open
mesh it is half of all directions and tends to none with the distance: there the nearest point decides, which is not on
the rim where the surface stands between the point and its front. Past the rim there is neither front nor back. The
solid angle of a triangle: van Oosterom and Strackee 1983, IEEE Trans Biomed Eng 30:125. It costs a look at every
triangle, so it is for results, and there only where nothing touches.
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

SHARE = 0.25  # of all directions: half of what is seen from close behind a plane
SEEN = 1e-3  # of all directions: less is rounding, or too far away to count
SAME = 1e-6  # share by which squares of distances to one point of two triangles may differ
_EDGES = (0, 1, 2, 4, 1 | 4, 1 | 2, 2 | 4)  # bits of the edges that each feature of a triangle lies on


class Behind(NamedTuple):
    """Whether a point is behind a surface; the other fields hold only if it is."""

    there: Array  # () bool: behind the surface
    depth: Scalar  # to the surface's nearest point [m]
    place: Array  # () int32: of the triangle that it is on


def behind(corners: Array, triangle: Array, rim: Array, p: Vec3, wanted: Array) -> Behind:
    """Whether a point sees the back of a surface in more than `SHARE` of all directions, or below its inside.

    Args:
        corners: (places, 9) of triangles [m]; copies are allowed.
        triangle: (places,) int32, which triangle each is, below the number of places.
        rim: (places,) integers, bits 1, 2, 4 for an edge ab, bc, ca on the rim of an open mesh.
        p: the point, same frame.
        wanted: () bool; otherwise the answer is no, and nothing is computed.

    Not differentiated.
    """

    def look(corners: Array, triangle: Array, rim: Array, p: Vec3, wanted: Array) -> Behind:
        nothing = jnp.zeros_like(p.x)
        share = jax.lax.cond(wanted, lambda: _back_solid_angle(corners, triangle, p), lambda: nothing)
        nowhere = Behind(jnp.asarray(False), nothing, jnp.zeros((), jnp.int32))
        return jax.lax.cond(share > SEEN, lambda: _below_surface(corners, rim, p, share > SHARE), lambda: nowhere)

    return member_by_member(look)(corners, triangle, rim, p, wanted)


def _below_surface(corners: Array, rim: Array, p: Vec3, surely: Array) -> Behind:
    """Where the nearest point is; behind its inside, or surely."""
    on = closest_on_triangle(Triangle.of_rows(corners), _repeated(p, corners))
    place = jnp.argmin(on.square).astype(jnp.int32)
    nearest = on.square <= (1 + SAME) * on.square[place]
    at_rim = (rim.astype(jnp.int32) & jnp.asarray(_EDGES, jnp.int32)[on.feature]) > 0
    inside = ~(nearest & (on.feature != FACE) & at_rim).any()
    return Behind(surely | inside, jnp.sqrt(on.square[place]), place)


def _back_solid_angle(corners: Array, triangle: Array, p: Vec3) -> Scalar:
    """Solid angle over 4 pi; negative where it is the front that is seen."""
    t = Triangle.of_rows(corners)
    here = _repeated(p, corners)
    a, b, c = t.a - here, t.b - here, t.c - here
    la, lb, lc = a.norm(), b.norm(), c.norm()
    angle = 2 * jnp.arctan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    once = jnp.zeros_like(angle).at[triangle].set(angle)
    return jnp.sum(once) / (4 * math.pi)


def _repeated(p: Vec3, corners: Array) -> Vec3:
    """The point once for every triangle."""
    return Vec3(*(jnp.broadcast_to(x, corners.shape[:1]) for x in (p.x, p.y, p.z)))


class MutualPlace(NamedTuple):
    """To the accuracy of a mesh's vertices."""

    gap: float  # least distance of their vertices [m]
    behind: float  # share of the second's area that is behind the first's surface
    deepest: float  # of its vertices below the plane at the nearest vertex there; 0 where none is [m]


def mutual_place(
    mesh: SurfaceMesh, other: SurfaceMesh, position: NDArray[np.float64], matrix: NDArray[np.float64]
) -> MutualPlace:
    """The position of one mesh relative to another.

    Args:
        mesh: whose surface has a back.
        other: looked at, vertex by vertex.
        position, matrix: of the other's frame in the mesh's, (3,) [m] and (3, 3).
    """
    from scipy.spatial import cKDTree

    points = other.vertices @ matrix.T + position
    away, near = cKDTree(mesh.vertices).query(points)
    height = np.einsum("ij,ij->i", points - mesh.vertices[near], mesh.vertex_normals[near])
    share = float(np.average(height < 0, weights=other.vertex_areas))
    return MutualPlace(float(np.min(away)), share, max(0.0, -float(np.min(height))))
