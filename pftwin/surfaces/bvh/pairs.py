"""Which triangles of two meshes may touch: both trees are gone down together.

From all pairs of nodes of two high levels, pairs whose bounding volumes are apart are dropped, the others replaced by
the pairs of their descendants, down to the triangles. Lists have fixed lengths. A list that would be longer is cut, and
the answer says so. In a batch all places of a list are worked on (`chunk=None`); a single query does better to go
through the lists piece by piece and to stop at their ends.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.spatial import Pose, Vec3
from pftwin.surfaces.bvh.compaction import Places, appended, empty
from pftwin.surfaces.bvh.tree import MeshTree
from pftwin.surfaces.triangle import Triangle
from pftwin.surfaces.triangle_pairs import straddle

FIRST = 3  # level of both trees that is looked at first
STRIDE = 2  # levels between two looks: sixteen pairs of descendants
NODES = {"disc": 1024, "box": 8192}  # pairs of nodes that there is room for
TRIANGLES = {"disc": 2048, "box": 2048}  # and of triangles
SLACK = 1e-5  # share of a mesh's size by which single precision is certainly not off


class Pairs(NamedTuple):
    """Pairs of triangles, by their places in the two trees."""

    a: Array  # (width,) int32
    b: Array  # (width,) int32
    count: Array  # () int32: entries that count, from the start
    overflow: Array  # () bool: pairs were lost

    def valid(self) -> Array:
        """Which entries count, (width,)."""
        return jnp.arange(self.a.shape[0], dtype=jnp.int32) < self.count


class _Front(NamedTuple):
    """Pairs of nodes, one of each tree."""

    a: Array
    b: Array
    count: Array


def candidate_pairs(
    a: MeshTree,
    b: MeshTree,
    X_AB: Pose,
    *,
    nodes: int | None = None,
    triangles: int | None = None,
    chunk: int | None = None,
) -> Pairs:
    """Triangles of two meshes that may touch: each reaches the other's plane, and no bounding volume keeps them apart.

    Args:
        a, b: trees of one kind.
        X_AB: pose of b's mesh in a's frame.
        nodes, triangles: room for pairs; None: what an implant and a button need, doubled.
        chunk: pairs of nodes that are worked on at once; None: all there is room for, as is best in a batch.

    Nothing here is differentiated. Jit and vmap apply.
    """
    if a.kind != b.kind:
        raise TypeError(f"trees of different kinds: {a.kind} and {b.kind}")
    a, b, X_AB = stop_gradient((a, b, X_AB))
    nodes = NODES[a.kind] if nodes is None else nodes
    triangles = TRIANGLES[a.kind] if triangles is None else triangles
    at = (min(FIRST, a.depth), min(FIRST, b.depth))
    both = jnp.arange(1 << (at[0] + at[1]), dtype=jnp.int32)
    everything = jnp.asarray(both.shape[0], jnp.int32)
    front = _Front(both >> at[1], both & ((1 << at[1]) - 1), everything)
    test = _volumes_overlap(a, b, X_AB, at, at)
    rooms = _rooms(a, b, nodes)
    front, overflow = _next(front, (1, 1), test, rooms.pop(), None)
    while at != (a.depth, b.depth):
        down = min(at[0] + STRIDE, a.depth), min(at[1] + STRIDE, b.depth)
        many = 1 << (down[0] - at[0]), 1 << (down[1] - at[1])
        front, lost = _next(front, many, _volumes_overlap(a, b, X_AB, at, down), rooms.pop(), chunk)
        overflow, at = overflow | lost, down
    front, lost = _next(front, (a.leaf, b.leaf), _triangles_straddle(a, b, X_AB), triangles, chunk)
    return Pairs(front.a, front.b, front.count, overflow | lost)


def _rooms(a: MeshTree, b: MeshTree, nodes: int) -> list[int]:
    """Room for pairs of nodes at every look, the leaves' first: half as much with every look further up."""
    looks = 1 + max(-(-(t.depth - FIRST) // STRIDE) for t in (a, b))
    least = 2 << (2 * FIRST)
    return [max(nodes >> k, min(nodes, least)) for k in range(max(looks, 1))]


def _next(
    front: _Front, many: tuple[int, int], test: Callable[[Array, Array], Array], width: int, chunk: int | None
) -> tuple[_Front, Array]:
    """The pairs of descendants that a test (n,), (n,) -> (many_a, many_b, n) lets pass, and whether some were lost."""
    room, each = front.a.shape[0], many[0] * many[1]
    size = room if chunk is None else min(chunk, room)

    def work(start: Array, found: Places) -> Places:
        i, j = (jax.lax.dynamic_slice_in_dim(x, start, size) for x in (front.a, front.b))
        there = start + jnp.arange(size, dtype=jnp.int32) < front.count
        mask = test(i, j).reshape(each, size) & there
        return appended(found, mask.reshape(-1), start * each)

    zero = jnp.zeros((), jnp.int32)
    if size == room:
        found = work(zero, empty(width))
    else:
        if room % size:
            raise ValueError(f"room for {room} pairs of nodes is no multiple of the chunk, {chunk}")
        _, found = jax.lax.while_loop(
            lambda at: at[0] < front.count, lambda at: (at[0] + size, work(*at)), (zero, empty(width))
        )
    piece, rest = found.index // (each * size), found.index % (each * size)
    parent, child = piece * size + rest % size, rest // size
    i = front.a[parent] * many[0] + child // many[1]
    j = front.b[parent] * many[1] + child % many[1]
    return _Front(i, j, jnp.minimum(found.total, width)), found.overflow()


def _volumes_overlap(
    a: MeshTree, b: MeshTree, X_AB: Pose, at: tuple[int, int], down: tuple[int, int]
) -> Callable[[Array, Array], Array]:
    """Of nodes at two levels: whether their descendants' bounding volumes overlap."""
    blocks = [t.levels[d].reshape(1 << u, 1 << (d - u), -1) for t, u, d in zip((a, b), at, down, strict=True)]
    rotation = X_AB.orientation.rotation().array().astype(jnp.float32)
    translation = X_AB.position.array().astype(jnp.float32)

    def test(i: Array, j: Array) -> Array:
        # The long axis last: what is worked on in one go lies side by side.
        first, second = (jnp.moveaxis(block[k], 0, 1) for block, k in zip(blocks, (i, j), strict=True))
        first, second = jax.lax.optimization_barrier((first, second))
        return a.volumes.overlap(first[:, None], second[None, :], rotation, translation)

    return test


def _triangles_straddle(a: MeshTree, b: MeshTree, X_AB: Pose) -> Callable[[Array, Array], Array]:
    """Of leaves: which of their triangles reach each other's planes."""
    X = jax.tree.map(lambda x: x.astype(jnp.float32), X_AB)
    rotation, position = X.orientation.rotation(), X.position
    room = SLACK * jnp.abs(a.levels[0]).max()  # of the order of what single precision rounds the root's numbers by

    def moved(p: Vec3) -> Vec3:
        return rotation.apply(p) + position

    def test(i: Array, j: Array) -> Array:
        both = ((a, i), (b, j))
        rows = [jnp.moveaxis(t.triangles.reshape(1 << t.depth, t.leaf, 9)[k], 0, 1) for t, k in both]
        there = [t.index.reshape(1 << t.depth, t.leaf)[k].T >= 0 for t, k in both]
        first, second = (Triangle.of_rows(r.astype(jnp.float32)) for r in rows)
        second = Triangle(moved(second.a), moved(second.b), moved(second.c))
        # Worked out once for every triangle, not again for every pair that it is in.
        known = jax.lax.optimization_barrier(((first, _unit_normal(first)), (second, _unit_normal(second))))
        (first, up), (second, over) = (
            jax.tree.map(lambda x, k=k: jnp.expand_dims(x, k), of) for k, of in zip((1, 0), known, strict=True)
        )
        return straddle(first, second, up, over, room) & there[0][:, None] & there[1][None, :]

    return test


def _unit_normal(t: Triangle) -> Vec3:
    normal = t.area_vector()
    size = normal.norm()
    return (1 / jnp.where(size > 0, size, 1)) * normal
