"""Triangles: nearest point, and the segment in which two triangles intersect, in closed form and differentiable.

The feature that the nearest point lies on (C. Ericson, Real-Time Collision Detection, section 5.1.5) is chosen without
derivatives. The point is then a projection onto the face or edge, or the corner itself, which is differentiable with
respect to all inputs. By the envelope theorem the distance's derivative is the unit vector between the two points. No
derivative is ever infinite, not even at a vertex, on an edge, or on the triangle itself.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3

T = TypeVar("T")
FACE = 0  # number of the face among a triangle's features; 1 to 3: edges ab, bc, ca; 4 to 6: corners a, b, c


class Triangle(eqx.Module):
    """A triangle or a batch of triangles; corners counter-clockwise seen from outside."""

    a: Vec3
    b: Vec3
    c: Vec3

    @staticmethod
    def of_rows(rows: Array) -> Triangle:
        """Makes triangles from arrays (..., 9): corners a, b, c."""
        return Triangle(*(Vec3(*(rows[..., 3 * k + i] for i in range(3))) for k in range(3)))

    def area_vector(self) -> Vec3:
        """Outward normal times twice the area [m^2]."""
        return (self.b - self.a).cross(self.c - self.a)

    def weights(self, p: Vec3) -> tuple[Scalar, Scalar, Scalar]:
        """Barycentric coordinates of a point in the triangle's plane; a degenerate triangle is its first corner."""
        normal, arm = self.area_vector(), p - self.a
        square = normal.squared_norm()
        over = jnp.where(square > 0, 1 / jnp.where(square > 0, square, 1), 0)
        b, c = over * arm.cross(self.c - self.a).dot(normal), over * (self.b - self.a).cross(arm).dot(normal)
        return 1 - b - c, b, c


class OnTriangle(NamedTuple):
    """The nearest point of a triangle."""

    point: Vec3
    square: Scalar  # squared distance [m^2]
    feature: Array  # int32: 0 the face, 1 to 3 an edge, 4 to 6 a corner


def closest_on_triangle(t: Triangle, p: Vec3) -> OnTriangle:
    """Nearest point of a triangle to p; both may be batches of one shape. A degenerate triangle is its edges."""
    ab, bc, ca = t.b - t.a, t.c - t.b, t.a - t.c
    ap, bp, cp = p - t.a, p - t.b, p - t.c
    normal = ab.cross(-ca)
    twice = normal.squared_norm()
    over = 1 / jnp.where(twice > 0, twice, 1)
    # Whether p is in the prism over the triangle.
    inside = (normal.cross(ab).dot(ap) > 0) & (normal.cross(bc).dot(bp) > 0) & (normal.cross(ca).dot(cp) > 0)
    inside = inside & (twice > 0)
    height = ap.dot(normal)
    best, feature = p - (height * over) * normal, jnp.zeros_like(twice, dtype=jnp.int32)
    square = jnp.where(inside, height * height * over, jnp.inf)
    for edge, (start, way, arm) in enumerate(((t.a, ab, ap), (t.b, bc, bp), (t.c, ca, cp))):
        at, s, corner = _on_edge(start, way, arm, p, edge)
        nearer = ~inside & (stop_gradient(s) < stop_gradient(square))
        best, square, feature = select(nearer, (at, s, corner), (best, square, feature))
    return OnTriangle(best, square, feature)


def _on_edge(start: Vec3, way: Vec3, arm: Vec3, p: Vec3, edge: int) -> tuple[Vec3, Scalar, Array]:
    """Nearest point of an edge, its squared distance, and the number of its feature: the edge or an end."""
    length = way.squared_norm()
    share = arm.dot(way) / jnp.where(length > 0, length, 1)
    before, beyond = share <= 0, share >= 1
    share = jnp.where(before, 0.0, jnp.where(beyond, 1.0, share))  # no derivative beyond the ends
    at = start + share * way
    corner = jnp.where(before, 4 + edge, jnp.where(beyond, 4 + (edge + 1) % 3, 1 + edge))
    return at, (p - at).squared_norm(), corner.astype(jnp.int32)


def half_extent(corners: Array) -> Scalar:
    """Half the largest extent of triangles along a coordinate axis, from their corners (n, 9) [m]."""
    points = corners.reshape(-1, 3)
    return 0.5 * jnp.max(jnp.max(points, axis=0) - jnp.min(points, axis=0))


class Segment(NamedTuple):
    """The intersection of two triangles, from `start` to `end` along the cross product of their normals."""

    start: Vec3
    end: Vec3
    # int32 bits: edges (1, 2, 4: ab, bc, ca) of the first and of the second triangle that the end is on (one of both)
    start_edges: tuple[Array, Array]
    end_edges: tuple[Array, Array]
    crossing: Array  # bool: whether they intersect


def triangles_cross(s: Triangle, t: Triangle) -> Array:
    """Whether two triangles cross: an edge of one pierces the other. Coplanar triangles do not count.

    For batches of one shape. Uses only signed volumes of tetrahedra, no division: an edge that pierces a triangle
    passes all its edges on the same side. The nine volumes, of an edge of each triangle, serve both.
    """
    turns = [_volumes(p, q, t) for p, q in ((s.a, s.b), (s.b, s.c), (s.c, s.a))]
    hit = jnp.zeros_like(s.a.x, dtype=bool)
    for k, crosses in enumerate(_edges_through(s, t)):
        hit = hit | (crosses & _same_sign(turns[k]))
    for k, crosses in enumerate(_edges_through(t, s)):
        hit = hit | (crosses & _same_sign([row[k] for row in turns]))
    return hit


def crossing(s: Triangle, t: Triangle) -> Segment:
    """The segment in which two triangles cross; for batches of one shape. Differentiable where they cross."""
    along = s.area_vector().cross(t.area_vector())
    ends = []
    for own, other in ((s, t), (t, s)):
        (p, q), bits, cuts = _edge_crossings(own, other)
        ahead = stop_gradient(p.dot(along) <= q.dot(along))
        ends.append((*select(ahead, (p, q, *bits), (q, p, *bits[::-1])), cuts))
    (s0, s1, s_bit0, s_bit1, s_cuts), (t0, t1, t_bit0, t_bit1, t_cuts) = ends
    from_s = stop_gradient(s0.dot(along) >= t0.dot(along))
    to_s = stop_gradient(s1.dot(along) <= t1.dot(along))
    zero = jnp.zeros_like(s_bit0)
    start, start_edges = select(from_s, (s0, (s_bit0, zero)), (t0, (zero, t_bit0)))
    end, end_edges = select(to_s, (s1, (s_bit1, zero)), (t1, (zero, t_bit1)))
    ahead = stop_gradient((end - start).dot(along)) > 0
    return Segment(start, end, start_edges, end_edges, s_cuts & t_cuts & ahead)


def _edge_crossings(own: Triangle, other: Triangle) -> tuple[tuple[Vec3, Vec3], tuple[Array, Array], Array]:
    """Where a triangle's edges cross the other's plane: two points, the bits of their edges, and whether they do."""
    normal = other.area_vector()
    corners = own.a, own.b, own.c
    heights = [(p - other.a).dot(normal) for p in corners]
    above = [stop_gradient(h > 0) for h in heights]
    # The corner that is alone on its side of the plane; both its edges cross the plane.
    lone_a = (above[0] != above[1]) & (above[0] != above[2])
    lone_b = (above[1] != above[0]) & (above[1] != above[2])
    cuts = (above[0] != above[1]) | (above[1] != above[2])

    def rolled(x: list, k: int):
        pick = [x[(i + k) % 3] for i in range(3)]
        return jnp.where(lone_a, pick[0], jnp.where(lone_b, pick[1], pick[2]))

    h = [rolled(heights, k) for k in range(3)]
    p = [jax.tree.map(lambda *x, k=k: rolled(list(x), k), *corners) for k in range(3)]
    ones = jnp.ones_like(h[0])
    points = []
    for k in (1, 2):
        share = h[0] / jnp.where(cuts, h[0] - h[k], ones)
        points.append(p[0] + share * (p[k] - p[0]))
    # From corner a the edges are ab and ca, from b bc and ab, from c ca and bc.
    bits = [rolled([jnp.full_like(h[0], b, jnp.int32) for b in row], 0) for row in ((1, 2, 4), (4, 1, 2))]
    return (points[0], points[1]), (bits[0], bits[1]), cuts


def select(first: Array, p: T, q: T) -> T:
    """Elementwise choice between two pytrees: p where `first` is true, else q."""
    return jax.tree.map(lambda x, y: jnp.where(first, x, y), p, q)


def _volumes(start: Vec3, end: Vec3, t: Triangle) -> list[Scalar]:
    """Six times the signed volumes of the tetrahedra of an edge and each of a triangle's edges."""
    way, a, b, c = end - start, t.a - start, t.b - start, t.c - start
    return [way.dot(p.cross(q)) for p, q in ((a, b), (b, c), (c, a))]


def _edges_through(edges: Triangle, face: Triangle) -> list[Array]:
    """Which edges of a triangle have their ends on different sides of another's plane."""
    normal = face.area_vector()
    above = [(p - face.a).dot(normal) > 0 for p in (edges.a, edges.b, edges.c)]
    return [above[k] != above[(k + 1) % 3] for k in range(3)]


def _same_sign(x: list[Scalar]) -> Array:
    """Whether no two of three numbers have opposite signs."""
    up = (x[0] >= 0) & (x[1] >= 0) & (x[2] >= 0)
    return up | ((x[0] <= 0) & (x[1] <= 0) & (x[2] <= 0))
