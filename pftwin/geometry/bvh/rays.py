"""Rays from a mesh's corners, against their normals, out of another mesh."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.corners import CornerTree
from pftwin.geometry.bvh.depth_bounds import ROUGH
from pftwin.geometry.bvh.triangle import Triangle

EDGE = 1e-12  # share of a triangle by which a ray may miss its edge and still count


class Longest(NamedTuple):
    """The longest ray through some triangles."""

    depth: Scalar  # [m]; -1 where none leaves through any
    lane: Array  # () int32: which triangle


def ray_depth(corner: Vec3, normal: Vec3, t: Triangle) -> tuple[Scalar, Array]:
    """How far from a corner, against its normal, a ray leaves through a triangle; and whether it does (bool)."""
    across = t.area_vector()
    steep = -normal.dot(across)
    leaves = steep > 0
    depth = (t.a - corner).dot(across) / jnp.where(leaves, steep, 1)
    # Signed volumes: the ray passes all edges on the same side.
    a, b, c = t.a - corner, t.b - corner, t.c - corner
    sides = [normal.dot(q.cross(p)) for p, q in ((a, b), (b, c), (c, a))]
    least = -EDGE * steep
    return depth, leaves & (sides[0] >= least) & (sides[1] >= least) & (sides[2] >= least)


def may_leave(a: Array, b: Array, X: Pose, deepest: Array) -> Array:
    """Which of single corners' rays may leave through discs and be longer than the longest so far, bool.

    Args:
        a, b: nodes' rows, a component a row; a single corner's disc has it as its middle, and its normal.
        X: of b's frame in a's, single precision.
        deepest: length of the longest ray so far [m].
    """
    rotation = X.orientation.rotation()
    point, normal = rotation.apply(Vec3(*b[:3])) + X.position, rotation.apply(Vec3(*b[3:6]))
    away, axis = point - Vec3(*a[:3]), Vec3(*a[3:6])
    slope = -normal.dot(axis)
    steep = slope > 0.1
    over = 1 / jnp.where(steep, slope, 1.0)
    middle, half = -away.dot(axis) * over, (a[7] + ROUGH) * over + ROUGH
    beside = (away - middle * normal).squared_norm()
    reach = a[6] + half + ROUGH
    passes = (middle + half > jnp.maximum(deepest, 0)) & (beside <= reach * reach)
    # Against a thin disc's normal no ray leaves; a thick one's triangles may look anywhere.
    back = (slope < -0.1) & (a[7] < 0.1 * a[6])
    return jnp.where(steep, passes, ~back)


def longest_ray(
    triangles: Array, first: Array, many: int, corners: CornerTree, j: Array, X: Pose, limit: Scalar
) -> Longest:
    """The ray of a corner through neighbouring triangles.

    Args:
        triangles: (places, 9), of all.
        first, many: of those tried.
        corners, j: the tree and the place of the corner.
        X: of the corners' frame in the triangles'.
        limit: longer rays do not count [m].
    """
    rows = jax.lax.dynamic_slice_in_dim(triangles, first, many).T
    t = Triangle(*(Vec3(*rows[3 * k : 3 * k + 3]) for k in range(3)))
    rotation = X.orientation.rotation()
    point = rotation.apply(Vec3(*corners.points[j])) + X.position
    depth, hit = ray_depth(point, rotation.apply(Vec3(*corners.normals[j])), t)
    depth = jnp.where(hit & (depth >= 0) & (depth <= limit), depth, -1.0)
    lane = jnp.argmax(depth).astype(jnp.int32)
    return Longest(depth[lane], lane)
