"""Which triangles of two meshes meet: the brute force's answer, by going down both trees.

Bounding volumes and planes are looked at in single precision, with room for its rounding; whether two triangles meet is
decided in full precision, on the few that are left.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Scalar
from pftwin.geometry.bvh.descent import Descent, descent, go_down, unpacked
from pftwin.geometry.bvh.members import member_by_member
from pftwin.geometry.bvh.planes import SLACK, leaves_with_planes, reach, size
from pftwin.geometry.bvh.queue import LANES, Queue, pushed_where, queue_of
from pftwin.geometry.bvh.tree import MeshTree
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.bvh.triangle_pairs import meet

LEAF = 4  # triangles in a leaf: sixteen pairs of triangles in a pair of leaves
NODES = {"disc": 2048, "box": 16384}  # pairs of nodes that there is room for
CANDIDATES = {"disc": 8192, "box": 32768}  # and of triangles that may meet
MEETING = 512  # and of triangles that do


class Pairs(NamedTuple):
    """Pairs of triangles, by their places in the two trees."""

    a: Array  # (width,) int32
    b: Array  # (width,) int32
    count: Array  # () int32: entries that count, from the start
    overflow: Array  # () bool: pairs were lost

    def valid(self) -> Array:
        """Which entries count, (width,)."""
        return jnp.arange(self.a.shape[0], dtype=jnp.int32) < self.count


class PairListLengths(NamedTuple):
    """How long the lists of a search are."""

    nodes: int
    candidates: int
    meeting: int = MEETING


class PairSearch(eqx.Module):
    """Two trees, laid out for searches: made once, before a loop."""

    a: MeshTree
    b: MeshTree
    way: Descent
    triangles: tuple[Array, Array]  # of both trees' leaves (leaves, 13, 4): with their planes
    near: Scalar  # how near to a plane a triangle counts as reaching it [m]
    room: PairListLengths = eqx.field(static=True)

    def meeting(self, X_AB: Pose) -> Pairs:
        """The triangles that meet with b's mesh at a pose in a's frame. Jit and vmap apply; not differentiated."""
        return member_by_member(_meeting)(self, X_AB)


def pair_search(a: MeshTree, b: MeshTree, room: PairListLengths | None = None) -> PairSearch:
    """The search for pairs of two trees.

    Args:
        a, b: trees of one kind, with four triangles a leaf.
        room: None: more than an implant and a button need.
    """
    if a.kind != b.kind:
        raise TypeError(f"trees of different kinds: {a.kind} and {b.kind}")
    if (a.leaf, b.leaf) != (LEAF, LEAF):
        raise TypeError(f"leaves of {a.leaf} and {b.leaf} triangles: expected {LEAF}")
    room = PairListLengths(NODES[a.kind], CANDIDATES[a.kind]) if room is None else room
    triangles = leaves_with_planes(a), leaves_with_planes(b)
    return PairSearch(a, b, descent(a.levels, b.levels), triangles, SLACK * (size(a) + size(b)), room)


def _meeting(search: PairSearch, X_AB: Pose) -> Pairs:
    a, b, room = search.a, search.b, search.room
    X = jax.tree.map(lambda x: x.astype(jnp.float32), X_AB)
    rotation, translation = X.orientation.rotation().array(), X.position.array()

    leaves, lost = go_down(search.way, lambda x, y: a.volumes.overlap(x, y, rotation, translation), room.nodes)
    candidates = _candidates(search, X, leaves)
    found = _exact(search, X_AB, leaves, candidates)
    pair, lane = _whose(leaves, found.entries[: room.meeting])
    i, j = unpacked(pair, b.depth)
    return Pairs(
        i * LEAF + lane // LEAF,
        j * LEAF + lane % LEAF,
        found.length,
        lost | candidates.overflow | found.overflow,
    )


def _whose(leaves: Queue, entries: Array) -> tuple[Array, Array]:
    """Pair of leaves and lane of an entry: the pair's place in its list times sixteen, plus the lane."""
    return leaves.entries[entries // LANES], entries % LANES


def _candidates(search: PairSearch, X: Pose, leaves: Queue) -> Queue:
    """Triangles that reach each other's planes."""

    def body(k: Array, found: Queue) -> Queue:
        i, j = unpacked(jax.lax.dynamic_index_in_dim(leaves.entries, k, 0, keepdims=False), search.b.depth)
        of_a, of_b = (
            jax.lax.dynamic_index_in_dim(x, y, 0, keepdims=False) for x, y in zip(search.triangles, (i, j), strict=True)
        )
        yes = reach(of_a, of_b, X, search.near)
        at = k * LANES
        return pushed_where(found, yes, lambda lane: at + lane)

    return jax.lax.fori_loop(jnp.zeros((), jnp.int32), leaves.length, body, queue_of(search.room.candidates))


def _exact(search: PairSearch, X: Pose, leaves: Queue, candidates: Queue) -> Queue:
    """Of the candidates those that meet, sixteen at a time."""
    b_depth = search.b.depth
    lanes = jnp.arange(LANES, dtype=jnp.int32)

    def body(state: tuple[Array, Queue]) -> tuple[Array, Queue]:
        start, found = state
        entries = jax.lax.dynamic_slice(candidates.entries, (start,), (LANES,))
        there = start + lanes < candidates.length
        entries = jnp.where(there, entries, 0)
        pair, lane = _whose(leaves, entries)
        i, j = unpacked(pair, b_depth)
        rows = search.a.triangles[i * LEAF + lane // LEAF], search.b.triangles[j * LEAF + lane % LEAF]
        first, second = (Triangle.of_rows(r) for r in jax.lax.optimization_barrier(rows))
        yes = meet(first, _moved(X, second)) & there
        return start + LANES, pushed_where(found, yes, lambda lane: entries[lane])

    start = jnp.zeros((), jnp.int32), queue_of(search.room.meeting)
    return jax.lax.while_loop(lambda s: s[0] < candidates.length, body, start)[1]


def _moved(X: Pose, t: Triangle) -> Triangle:
    rotation, position = X.orientation.rotation(), X.position
    return Triangle(*(rotation.apply(p) + position for p in (t.a, t.b, t.c)))
