"""Whether two triangles have a point in common."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

from pftwin.spatial import Scalar, Vec3
from pftwin.surfaces.triangle import Triangle


def straddle(s: Triangle, t: Triangle, normal_s: Vec3, normal_t: Vec3, room: Scalar) -> Array:
    """Whether each triangle reaches the other's plane, or `room` [m] short of it: without it they cannot meet.

    For batches whose shapes broadcast; normals are unit, or zero for a triangle without area.
    """
    return _reaches(s, t, normal_t, room) & _reaches(t, s, normal_s, room)


def meet(s: Triangle, t: Triangle) -> Array:
    """Whether two triangles cross: an edge of one pierces the other. Triangles in one plane do not count.

    With signed volumes of tetrahedra alone, no division; for batches of one shape.
    """
    hit = jnp.zeros_like(s.a.x, dtype=bool)
    for edges, face in ((s, t), (t, s)):
        normal = face.area_vector()
        heights = [(p - face.a).dot(normal) for p in (edges.a, edges.b, edges.c)]
        corners = (edges.a, edges.b, edges.c)
        for i in range(3):
            j = (i + 1) % 3
            crosses = (heights[i] > 0) != (heights[j] > 0)
            hit = hit | (crosses & _between(corners[i], corners[j] - corners[i], face))
    return hit


def _between(start: Vec3, way: Vec3, face: Triangle) -> Array:
    """Whether a line passes through a triangle: on the same side of all its edges."""
    a, b, c = face.a - start, face.b - start, face.c - start
    turns = [way.dot(p.cross(q)) for p, q in ((a, b), (b, c), (c, a))]
    up = (turns[0] >= 0) & (turns[1] >= 0) & (turns[2] >= 0)
    return up | ((turns[0] <= 0) & (turns[1] <= 0) & (turns[2] <= 0))


def _reaches(s: Triangle, t: Triangle, normal: Vec3, room: Scalar) -> Array:
    """Whether s has corners on both sides of t's plane, or near it."""
    heights = [(p - t.a).dot(normal) for p in (s.a, s.b, s.c)]
    low = jnp.minimum(jnp.minimum(heights[0], heights[1]), heights[2])
    high = jnp.maximum(jnp.maximum(heights[0], heights[1]), heights[2])
    return (low <= room) & (high >= -room)
