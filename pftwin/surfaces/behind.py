"""Whether a point is behind a surface, however far: by the solid angle under which it sees the surface's back.

Inside a closed mesh that is all directions, outside none; in front of an open one it is negative. The solid angle of a
triangle: van Oosterom and Strackee 1983, IEEE Trans Biomed Eng 30:125. It costs a look at every triangle, so it is for
results, and there only where nothing touches.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.spatial import Scalar, Vec3
from pftwin.surfaces.bvh.members import member_by_member
from pftwin.surfaces.triangle import Triangle

SHARE = 0.25  # of all directions: half of what is seen from close behind a plane


def behind(corners: Array, triangle: Array, p: Vec3, wanted: Array) -> Array:
    """Whether a point sees the back of a surface in more than `SHARE` of all directions. Not differentiated.

    Args:
        corners: (places, 9) of triangles [m]; copies are allowed.
        triangle: (places,) int32, which triangle each is, below the number of places.
        p: the point, same frame.
        wanted: () bool; otherwise the answer is no, and nothing is computed.
    """

    def look(corners: Array, triangle: Array, p: Vec3, wanted: Array) -> Array:
        share = jax.lax.cond(wanted, lambda: _back(corners, triangle, p), lambda: jnp.zeros_like(p.x))
        return share > SHARE

    return member_by_member(look)(corners, triangle, p, wanted)


def _back(corners: Array, triangle: Array, p: Vec3) -> Scalar:
    """Solid angle over 4 pi; negative where it is the front that is seen."""
    t = Triangle.of_rows(corners)
    here = Vec3(*(jnp.broadcast_to(x, corners.shape[:1]) for x in (p.x, p.y, p.z)))
    a, b, c = t.a - here, t.b - here, t.c - here
    la, lb, lc = a.norm(), b.norm(), c.norm()
    angle = 2 * jnp.arctan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    once = jnp.zeros_like(angle).at[triangle].set(angle)
    return jnp.sum(once) / (4 * math.pi)
