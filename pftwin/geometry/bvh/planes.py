"""Triangles with their planes in single precision, four to a leaf: which of two leaves' triangles may meet.

Two triangles meet only where each reaches the other's plane. Planes are made in full precision, so that single
precision tells heights above them to some ten nanometres, however narrow a triangle is; what is narrower than even full
precision can tell the plane of reaches everything.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.tree import MeshTree
from pftwin.geometry.bvh.triangle import Triangle

SLACK = 1e-5  # share of a mesh's size by which single precision is certainly not off
Rows = Array  # (13, 4): components of three corners, of a unit normal, and the plane's height above the origin


def leaves_with_planes(tree: MeshTree) -> Array:
    """Of every leaf (leaves, 13, 4) float32; NaN, which reaches nothing, where a place is empty."""
    t = Triangle.of_rows(tree.triangles)
    normal, ab, ac = t.area_vector(), t.b - t.a, t.c - t.a
    square, long = normal.squared_norm(), ab.squared_norm() + ac.squared_norm()
    blurred = float(jnp.finfo(square.dtype).eps) / SLACK
    known = square > (blurred * long) ** 2
    over = jnp.where(known, 1 / jnp.sqrt(jnp.where(known, square, 1.0)), 0.0)
    unit = over * normal
    plane = jnp.stack([unit.x, unit.y, unit.z, unit.dot(t.a)], axis=-1)
    rows = jnp.concatenate([tree.triangles, plane], axis=-1).astype(jnp.float32)
    rows = jnp.where((tree.index >= 0)[:, None], rows, jnp.nan)
    return jnp.swapaxes(rows.reshape(-1, tree.leaf, rows.shape[-1]), 1, 2)


def size(tree: MeshTree) -> Scalar:
    """The largest coordinate of a mesh [m]."""
    return jnp.abs(tree.triangles).max().astype(jnp.float32)


def reach(of_a: Rows, of_b: Rows, X_AB: Pose, room: Scalar) -> Array:
    """Which triangles of two leaves reach each other's planes, or `room` [m] short of them, (4, 4) bool."""
    rotation, position = X_AB.orientation.rotation(), X_AB.position
    (corners_a, normal_a, height_a), (corners_b, normal_b, height_b) = (_parts(r) for r in (of_a, of_b))
    # Planes are brought into the other's frame, not corners: they are fewer.
    b_in_a = rotation.apply(normal_b)
    first = _reaches(corners_a, 0, b_in_a, height_b + b_in_a.dot(position), room)
    second = _reaches(corners_b, 1, rotation.unapply(normal_a), height_a - normal_a.dot(position), room)
    return first & second


def _parts(rows: Rows) -> tuple[list[Vec3], Vec3, Array]:
    return [Vec3(*rows[3 * k : 3 * k + 3]) for k in range(3)], Vec3(*rows[9:12]), rows[12]


def _reaches(corners: list[Vec3], axis: int, normal: Vec3, height: Array, room: Scalar) -> Array:
    """Whether corners (4,), along one axis of the answer, are on both sides of planes (4,) along the other, or near."""
    down, across = (slice(None), None), (None, slice(None))
    of_corner, of_plane = (down, across) if axis == 0 else (across, down)
    n, h = Vec3(*(x[of_plane] for x in (normal.x, normal.y, normal.z))), height[of_plane]
    above = [n.x * p.x[of_corner] + n.y * p.y[of_corner] + n.z * p.z[of_corner] - h for p in corners]
    low, high = _lesser(_lesser(above[0], above[1]), above[2]), _greater(_greater(above[0], above[1]), above[2])
    return (low <= room) & (high >= -room)


def _lesser(x: Array, y: Array) -> Array:
    # One instruction; `minimum`, which must hand on NaN, is four. Here NaN is in all corners or in none.
    return jnp.where(x < y, x, y)


def _greater(x: Array, y: Array) -> Array:
    return jnp.where(x > y, x, y)
