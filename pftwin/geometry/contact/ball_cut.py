r"""Closed-form integrals over the part of a triangle inside a ball: area, depth and their moments.

For a ball of radius R about the origin, the depth of a point q of the surface is its power,

    depth(q) = (R^2 - |q|^2) / (2 R),

which near the ball's surface is the distance to it. On a triangle's plane, at a height h from the origin, the depth is
(rho^2 - r^2) / (2 R), where r is the distance from the foot of the normal and rho^2 = R^2 - h^2. By the divergence
theorem every integral is a sum over the three edges: for each edge the part inside the circle rho, from a quadratic
equation, and the angle that the rest subtends at the foot. This is exact for triangles of any size, whether the ball
dips into the middle of a large one, cuts its edges or contains it.

Moving the ball by dc changes the depth by (q . dc) / R, so the gradient of the volume with respect to the centre is the
first moment of the area over R; the boundary, where the depth is zero, contributes nothing.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.geometry.bvh.triangle import Triangle


class BallCut(NamedTuple):
    """Integrals over the part of a surface inside a ball about the origin."""

    area: Scalar  # [m^2]
    doubled: Scalar  # integral of R^2 - |q|^2: 2 R times the volume between the surface and the ball [m^4]
    moment: Vec3  # integral of the position q [m^3]
    flux: Scalar  # flux of q through the area; negative if the origin is on the outer side [m^3]


class BallArcs(NamedTuple):
    """Integrals over the arcs of the outline, each over its circle's radius: the slopes of area and moment."""

    turned: Scalar  # angle of the arcs [rad]
    moment: Vec3  # integral of q [m]
    product: tuple[Vec3, Vec3, Vec3]  # rows of the integral of q q^T [m^2]


class _Cut(NamedTuple):
    """A triangle's plane relative to the ball, and its three edges relative to the circle."""

    normal: Vec3
    height: Scalar
    circle: Scalar  # rho^2
    disjoint: Array  # bool: no overlap
    edges: list[tuple[Vec3, Vec3, Vec3, Scalar, _Edge]]  # start, vector, inward normal, arm (see `_edge`), contribution


def _cut(t: Triangle, radius: Scalar) -> _Cut:
    ways = t.b - t.a, t.c - t.b, t.a - t.c
    across = ways[0].cross(ways[1])
    square = across.squared_norm()
    n = (1 / jnp.sqrt(jnp.where(square > 0, square, 1.0))) * across
    height = n.dot(t.a)
    circle = radius * radius - height * height
    flat = (square <= 0) | (circle <= 0)
    circle = jnp.where(flat, 1.0, circle)
    edges = []
    for q, way in zip((t.a, t.b, t.c), ways, strict=True):
        inward = n.cross(way)
        arm = q.dot(inward)
        edges.append((q, way, inward, arm, _edge(q, way, arm, circle, radius)))
    inside, turned = (sum(x[4][k] for x in edges) for k in range(2))
    # Out of reach, sums are zero except for rounding, which must not count as contact; unless the circle is all inside.
    return _Cut(n, height, circle, flat | ((inside <= 0) & (turned < math.pi)), edges)


def ball_cut(t: Triangle, radius: Scalar) -> BallCut:
    """Integrals over the parts of triangles inside a ball about the origin of a radius [m].

    Zero for triangles without area or out of reach.
    """
    n, height, circle, disjoint, edges = _cut(t, radius)
    zero = jnp.zeros_like(height)
    turned, swept, bulge, moment = zero, zero, zero, Vec3(zero, zero, zero)
    for _, _, inward, arm, e in edges:
        turned, swept = turned + e.turned, swept + e.inside * arm
        bulge, moment = bulge + e.stretch * arm, moment + e.stretch * inward
    area = 0.5 * (circle * turned - swept)
    moment = 0.5 * moment + (height * area) * n
    values = area, 0.5 * circle * area - 0.25 * bulge, moment.x, moment.y, moment.z, height * area
    area, doubled, x, y, z, flux = (jnp.where(disjoint, 0.0, a) for a in values)
    return BallCut(area, doubled, Vec3(x, y, z), flux)


def ball_arcs(t: Triangle, radius: Scalar) -> BallArcs:
    """Integrals over the arcs in which a ball's surface intersects triangles.

    Along the circle r has the derivative n x r. So the integral of r is n x (sum of the edges' parts inside), and that
    of 2 r r^T - rho^2 (1 - n n^T) is the difference of the symmetric part of r (n x r)^T between the arcs' ends.
    """
    n, height, circle, disjoint, edges = _cut(t, radius)
    zero = jnp.zeros_like(height)
    turned, across = zero, Vec3(zero, zero, zero)
    rows = [Vec3(zero, zero, zero)] * 3
    for q, way, inward, _, e in edges:
        turned, across = turned + e.turned, across + e.inside * inward
        # Difference of the symmetric product of r and n x r between the points where the edge enters and leaves.
        start, both = q - height * n, 0.5 * (e.leave + e.enter)
        middle = start + both * way
        for one, two in ((middle, inward), (way, n.cross(middle))):
            share = 0.25 * e.inside
            rows = [
                row + (share * a) * two + (share * b) * one
                for row, a, b in zip(rows, (one.x, one.y, one.z), (two.x, two.y, two.z), strict=True)
            ]
    # Back from r to q = height n + r.
    half = 0.5 * circle * turned
    along = (height * height * turned - half) * n + height * across
    up = height * n
    product = [
        row + a * along + b * up
        for row, a, b in zip(rows, (n.x, n.y, n.z), (across.x, across.y, across.z), strict=True)
    ]
    product = [
        Vec3(*(x + half if i == j else x for j, x in enumerate((row.x, row.y, row.z)))) for i, row in enumerate(product)
    ]
    moment = (height * turned) * n + across
    components = [jnp.where(disjoint, 0.0, x) for v in (moment, *product) for x in (v.x, v.y, v.z)]
    vectors = [Vec3(*components[k : k + 3]) for k in range(0, 12, 3)]
    return BallArcs(jnp.where(disjoint, 0.0, turned), vectors[0], (vectors[1], vectors[2], vectors[3]))


def edge_in_ball(q: Vec3, way: Vec3, radius: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar, Scalar]:
    """|way|^2, q . way and |q|^2 - R^2 of an edge from q, and where it enters and leaves a ball about the origin.

    These are shares of the edge's length; equal if it does not meet the ball.
    """
    length, half, excess = way.squared_norm(), q.dot(way), q.squared_norm() - radius * radius
    over = 1 / jnp.where(length > 0, length, 1.0)
    root = half * half - length * excess
    half_chord = safe_sqrt(jnp.where(root > 0, root, 0.0))
    enter, leave = (jnp.clip((sign * half_chord - half) * over, 0.0, 1.0) for sign in (-1.0, 1.0))
    return length, half, excess, enter, leave


class _Edge(NamedTuple):
    """The contribution of one directed edge."""

    inside: Scalar  # share of its length inside the circle
    turned: Scalar  # angle that the rest subtends at the foot [rad]
    stretch: Scalar  # integral of rho^2 - r^2 over the share inside [m^2]
    enter: Scalar  # start of the part inside, as a share of the length
    leave: Scalar  # its end


def _edge(q: Vec3, way: Vec3, arm: Scalar, circle: Scalar, radius: Scalar) -> _Edge:
    """The contribution of one directed edge.

    Args:
        q, way: its start, and the vector to its end.
        arm: component of q along the edge's inward normal, times the edge's length.
        circle, radius: rho^2, and R.
    """
    length, half, excess, enter, leave = edge_in_ball(q, way, radius)
    inside, both = leave - enter, enter + leave
    stretch = -inside * (excess + half * both + length * (both * both - enter * leave) * (1 / 3))
    # Sum of the angles before and after the part inside, as the argument of the product of two complex numbers.
    start = excess + circle
    end = start + 2 * half + length
    a, b = start + enter * half, -enter * arm
    c, d = end - (1 - leave) * (half + length), (leave - 1) * arm
    return _Edge(inside, angle(a * c - b * d, a * d + b * c), stretch, enter, leave)


# On a CPU XLA's atan2 calls the C library for one number at a time; the function below is vectorized.


# atan(x) = x + x^3 P(x^2) / Q(x^2) for |x| < 0.66: Cephes library (S. L. Moshier 1989), relative error below 2e-16.
_P = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_Q = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
_EIGHTH = math.tan(math.pi / 8)


@jax.custom_jvp
def angle(real: Scalar, imaginary: Scalar) -> Scalar:
    """Argument of a complex number in (-pi, pi] [rad]; 0 with zero derivative for zero."""
    x, y = jnp.abs(real), jnp.abs(imaginary)
    low, high = jnp.minimum(x, y), jnp.maximum(x, y)
    far = low > _EIGHTH * high
    below = jnp.where(far, low + high, high)
    t = jnp.where(far, low - high, low) / jnp.where(below > 0, below, 1.0)
    z = t * t
    a = t + t * z * (_horner(_P, z) / _horner(_Q, z)) + jnp.where(far, math.pi / 4, 0.0)
    a = jnp.where(y > x, math.pi / 2 - a, a)
    a = jnp.where(real < 0, math.pi - a, a)
    return jnp.where(imaginary < 0, -a, a)


@angle.defjvp
def _angle_jvp(primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    (x, y), (dx, dy) = primals, tangents
    square = x * x + y * y
    turn = jnp.where(square > 0, 1 / jnp.where(square > 0, square, 1.0), 0.0)
    return angle(x, y), turn * (x * dy - y * dx)


def _horner(coefficients: tuple[float, ...], z: Scalar) -> Scalar:
    return reduce(lambda total, c: total * z + c, coefficients[1:], jnp.full_like(z, coefficients[0]))
