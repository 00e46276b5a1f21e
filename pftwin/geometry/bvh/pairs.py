"""Finds the pairs of triangles of two meshes that intersect, by descending both trees.

The result is that of testing all pairs. Bounding volumes and planes are tested in single precision, with a margin for
rounding; the remaining pairs of triangles are tested in full precision.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.descent import Descent, descent, go_down, unpacked
from pftwin.geometry.bvh.loops import LANES, Queue, member_by_member, pushed_where, queue_of
from pftwin.geometry.bvh.tree import MeshTree, discs_overlap
from pftwin.geometry.bvh.triangle import Triangle, triangles_cross

LEAF = 4  # triangles in a leaf: sixteen pairs of triangles in a pair of leaves
NODES = 2048  # capacity for pairs of nodes
CANDIDATES = 8192  # capacity for pairs of triangles that may intersect
MEETING = 512  # capacity for pairs of triangles that do


class Pairs(NamedTuple):
    """Pairs of triangles that intersect."""

    a: Array  # (width,) int32: places in the first tree
    b: Array  # (width,) int32: places in the second tree
    count: Array  # () int32: number of valid entries, at the start
    overflow: Array  # () bool: a list was full and pairs were lost


class PairListLengths(NamedTuple):
    """Capacities of the lists of a search."""

    nodes: int  # pairs of nodes
    candidates: int  # pairs of triangles that may intersect
    meeting: int = MEETING  # pairs of triangles that do


class PairSearch(eqx.Module):
    """The search for intersecting triangles of two trees; make it once, before a loop."""

    a: MeshTree
    b: MeshTree
    descent: Descent
    triangles: tuple[Array, Array]  # both trees' leaves (leaves, 13, 4): triangles and their planes
    near: Scalar  # distance within which a triangle is taken to reach a plane [m]
    room: PairListLengths = eqx.field(static=True)  # capacities

    def meeting(self, X_AB: Pose) -> Pairs:
        """Pairs that intersect with b at a pose in a's frame. Supports jit and vmap; no derivatives."""
        return member_by_member(_leaves_that_meet)(self, X_AB)


def pair_search(a: MeshTree, b: MeshTree, room: PairListLengths | None = None) -> PairSearch:
    """Makes the search for intersecting triangles of two trees with four triangles per leaf.

    `room` holds capacities; None: more than an implant and a button need.
    """
    if (a.leaf, b.leaf) != (LEAF, LEAF):
        raise TypeError(f"leaves of {a.leaf} and {b.leaf} triangles: expected {LEAF}")
    room = PairListLengths(NODES, CANDIDATES) if room is None else room
    triangles = leaves_with_planes(a), leaves_with_planes(b)
    largest = [jnp.abs(tree.triangles).max().astype(jnp.float32) for tree in (a, b)]
    return PairSearch(a, b, descent(a.levels, b.levels), triangles, SLACK * (largest[0] + largest[1]), room)


def _leaves_that_meet(search: PairSearch, X_AB: Pose) -> Pairs:
    b, room = search.b, search.room
    X = jax.tree.map(lambda x: x.astype(jnp.float32), X_AB)
    rotation = X.orientation.rotation()
    leaves, lost = go_down(search.descent, lambda x, y: discs_overlap(x, y, rotation, X.position), room.nodes)
    candidates = _candidates(search, X, leaves)
    found = _exact(search, X_AB, leaves, candidates)
    pair, lane = _pair_and_lane(leaves, found.entries[: room.meeting])
    i, j = unpacked(pair, b.depth)
    overflow = lost | candidates.overflow | found.overflow
    return Pairs(i * LEAF + lane // LEAF, j * LEAF + lane % LEAF, found.length, overflow)


def _pair_and_lane(leaves: Queue, entries: Array) -> tuple[Array, Array]:
    """Pair of leaves and lane of an entry, which is the pair's position in its list times sixteen, plus the lane."""
    return leaves.entries[entries // LANES], entries % LANES


def _candidates(search: PairSearch, X: Pose, leaves: Queue) -> Queue:
    """Pairs of triangles that reach each other's planes."""

    def body(k: Array, found: Queue) -> Queue:
        i, j = unpacked(jax.lax.dynamic_index_in_dim(leaves.entries, k, 0, keepdims=False), search.b.depth)
        of_a, of_b = (
            jax.lax.dynamic_index_in_dim(x, y, 0, keepdims=False) for x, y in zip(search.triangles, (i, j), strict=True)
        )
        yes = triangles_may_touch(of_a, of_b, X, search.near)
        at = k * LANES
        return pushed_where(found, yes, lambda lane: at + lane)

    return jax.lax.fori_loop(jnp.zeros((), jnp.int32), leaves.length, body, queue_of(search.room.candidates))


def _exact(search: PairSearch, X: Pose, leaves: Queue, candidates: Queue) -> Queue:
    """The candidates that intersect, tested sixteen at a time."""
    b_depth = search.b.depth
    lanes = jnp.arange(LANES, dtype=jnp.int32)

    def body(state: tuple[Array, Queue]) -> tuple[Array, Queue]:
        start, found = state
        entries = jax.lax.dynamic_slice(candidates.entries, (start,), (LANES,))
        there = start + lanes < candidates.length
        entries = jnp.where(there, entries, 0)
        pair, lane = _pair_and_lane(leaves, entries)
        i, j = unpacked(pair, b_depth)
        rows = search.a.triangles[i * LEAF + lane // LEAF], search.b.triangles[j * LEAF + lane % LEAF]
        first, second = (Triangle.of_rows(r) for r in jax.lax.optimization_barrier(rows))
        moved = Triangle(*(X.apply(p) for p in (second.a, second.b, second.c)))
        yes = triangles_cross(first, moved) & there
        return start + LANES, pushed_where(found, yes, lambda lane: entries[lane])

    start = jnp.zeros((), jnp.int32), queue_of(search.room.meeting)
    return jax.lax.while_loop(lambda s: s[0] < candidates.length, body, start)[1]


# Two triangles intersect only if each reaches the other's plane. Planes are computed in full precision, so that heights
# above them are right to some ten nanometres in single precision; a triangle too narrow for that passes every test.


SLACK = 1e-5  # upper bound on the error of single precision, as a share of the mesh's size
Rows = Array  # (13, 4): components of three corners and of a unit normal, and the plane's height above the origin


def leaves_with_planes(tree: MeshTree) -> Array:
    """Triangles and planes of every leaf (leaves, 13, 4), float32; NaN, which fails every test, in an empty place."""
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


def triangles_may_touch(of_a: Rows, of_b: Rows, X_AB: Pose, room: Scalar) -> Array:
    """Which triangles of two leaves reach each other's planes, or come within `room` [m] of them, (4, 4) bool."""
    rotation, position = X_AB.orientation.rotation(), X_AB.position
    (corners_a, normal_a, height_a), (corners_b, normal_b, height_b) = (_parts(r) for r in (of_a, of_b))
    # Planes are moved into the other's frame, not corners: there are fewer.
    b_in_a = rotation.apply(normal_b)
    first = _straddles(corners_a, 0, b_in_a, height_b + b_in_a.dot(position), room)
    second = _straddles(corners_b, 1, rotation.unapply(normal_a), height_a - normal_a.dot(position), room)
    return first & second


def _parts(rows: Rows) -> tuple[list[Vec3], Vec3, Array]:
    return [Vec3(*rows[3 * k : 3 * k + 3]) for k in range(3)], Vec3(*rows[9:12]), rows[12]


def _straddles(corners: list[Vec3], axis: int, normal: Vec3, height: Array, room: Scalar) -> Array:
    """Whether corners (4,), along one axis of the result, are on both sides of planes (4,) along the other, or near."""
    down, across = (slice(None), None), (None, slice(None))
    of_corner, of_plane = (down, across) if axis == 0 else (across, down)
    n, h = Vec3(*(x[of_plane] for x in (normal.x, normal.y, normal.z))), height[of_plane]
    above = [n.x * p.x[of_corner] + n.y * p.y[of_corner] + n.z * p.z[of_corner] - h for p in corners]
    low, high = _lesser(_lesser(above[0], above[1]), above[2]), _greater(_greater(above[0], above[1]), above[2])
    return (low <= room) & (high >= -room)


def _lesser(x: Array, y: Array) -> Array:
    # One instruction; `minimum`, which must propagate NaN, takes four. Here all corners are NaN or none is.
    return jnp.where(x < y, x, y)


def _greater(x: Array, y: Array) -> Array:
    return jnp.where(x > y, x, y)
