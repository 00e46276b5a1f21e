"""The point of a triangle nearest to a point, in closed form, with the derivatives of what it is: face, edge or corner.

Where it lies (C. Ericson, Real-Time Collision Detection, section 5.1.5) is decided without derivatives; from there the
point is a projection onto the face or the edge, or the corner itself, which is differentiable with respect to all. The
distance's derivative is then the unit vector between the two points, as the envelope theorem says, and none is ever
infinite: at a vertex, on an edge, or on the triangle itself.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3

FACE, EDGES, CORNERS = 0, (1, 2, 3), (4, 5, 6)  # edge 1 is ab, 2 is bc, 3 is ca; corner 4 is a


class Triangle(eqx.Module):
    """A triangle, or a batch of them; counter-clockwise seen from outside."""

    a: Vec3
    b: Vec3
    c: Vec3

    @staticmethod
    def of_rows(rows: Array) -> Triangle:
        """From arrays (..., 9): corners a, b, c."""
        return Triangle(*(Vec3(*(rows[..., 3 * k + i] for i in range(3))) for k in range(3)))

    def area_vector(self) -> Vec3:
        """Outward normal times twice the area [m^2]."""
        return (self.b - self.a).cross(self.c - self.a)


class OnTriangle(NamedTuple):
    """Where the nearest point lies."""

    point: Vec3
    square: Scalar  # of the distance [m^2]
    feature: Array  # int32: 0 the face, 1 to 3 an edge, 4 to 6 a corner


def closest_on_triangle(t: Triangle, p: Vec3) -> OnTriangle:
    """The point of a triangle nearest to p, for batches of one shape. A triangle without area counts as its edges."""
    ab, bc, ca = t.b - t.a, t.c - t.b, t.a - t.c
    ap, bp, cp = p - t.a, p - t.b, p - t.c
    normal = ab.cross(-ca)
    twice = normal.squared_norm()
    over = 1 / jnp.where(twice > 0, twice, 1)
    # Inside the prism over the triangle, on whose sides the edges' normals stand.
    inside = (normal.cross(ab).dot(ap) > 0) & (normal.cross(bc).dot(bp) > 0) & (normal.cross(ca).dot(cp) > 0)
    inside = inside & (twice > 0)
    height = ap.dot(normal)
    best, feature = p - (height * over) * normal, jnp.zeros_like(twice, dtype=jnp.int32)
    square = jnp.where(inside, height * height * over, jnp.inf)
    for edge, (start, way, arm) in enumerate(((t.a, ab, ap), (t.b, bc, bp), (t.c, ca, cp))):
        at, s, corner = _on_edge(start, way, arm, p, edge)
        nearer = ~inside & (stop_gradient(s) < stop_gradient(square))
        best = Vec3(*(jnp.where(nearer, n, o) for n, o in zip(_parts(at), _parts(best), strict=True)))
        square, feature = jnp.where(nearer, s, square), jnp.where(nearer, corner, feature)
    return OnTriangle(best, square, feature)


def _on_edge(start: Vec3, way: Vec3, arm: Vec3, p: Vec3, edge: int) -> tuple[Vec3, Scalar, Array]:
    """The nearest point of an edge, the square of its distance, and whether it is the edge or one of its corners."""
    length = way.squared_norm()
    share = arm.dot(way) / jnp.where(length > 0, length, 1)
    before, beyond = share <= 0, share >= 1
    share = jnp.where(before, 0.0, jnp.where(beyond, 1.0, share))  # its derivative ends at the corners
    at = start + share * way
    corner = jnp.where(before, 4 + edge, jnp.where(beyond, 4 + (edge + 1) % 3, 1 + edge))
    return at, (p - at).squared_norm(), corner.astype(jnp.int32)


def _parts(v: Vec3) -> tuple[Scalar, Scalar, Scalar]:
    return v.x, v.y, v.z


def half_extent(corners: Array) -> Scalar:
    """Half the largest extent along an axis of triangles given by their corners (n, 9) [m]."""
    points = corners.reshape(-1, 3)
    return 0.5 * jnp.max(jnp.max(points, axis=0) - jnp.min(points, axis=0))
