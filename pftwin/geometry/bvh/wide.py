"""A sixteen-way tree of a mesh, with searches for the nearest triangle and for the triangles inside a ball.

On a CPU XLA compiles a whole loop to one function: a loop over nodes, with the discs of a node's sixteen descendants in
as many lanes, tests a disc in a few nanoseconds. Batches run one element at a time (see `pftwin.geometry.bvh.loops`).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh.loops import member_by_member, written_where
from pftwin.geometry.bvh.tree import CANCELLED, MeshTree
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.walk import FAN, SLACK, blocks_of, nowhere, stored_levels


class WideTree(eqx.Module):
    """A mesh's tree of discs, down to single triangles, in blocks of sixteen.

    Nodes are numbered level by level; the top level has `first` nodes, and the sixteen children of node i start at
    16 i + first. Numbers from `n_inner` on are triangles, in the order of their places.
    """

    blocks: Array  # (nodes + 1, 8, 16) float32: discs (component, lane) of the top level, then of nodes' children
    first: int = eqx.field(static=True)  # nodes at the top
    n_levels: int = eqx.field(static=True)

    @property
    def n_inner(self) -> int:
        """Number of inner nodes, which precede the triangles."""
        return self.first * (FAN ** (self.n_levels - 1) - 1) // (FAN - 1)

    def node_sums(self, values: Array) -> Array:
        """Sums of triangles' values (places, k) over each node, triangles included, (nodes, k)."""
        rows = [values]
        for _ in range(self.n_levels - 1):
            rows.append(rows[-1].reshape(-1, FAN, values.shape[-1]).sum(axis=1))
        return jnp.concatenate(rows[::-1])

    def lateral(self) -> NDArray[np.float64]:
        """1 for nodes in the second half of the places (the lateral facet), else 0, (nodes,)."""
        sizes = [self.first * FAN**k for k in range(self.n_levels)]
        return np.concatenate([(2 * np.arange(n) >= n).astype(np.float64) for n in sizes])

    def below(self, node: Array) -> tuple[Array, Array]:
        """Block (8, 16) of a node's children, or of the top level for node -1, and the number of its first lane."""
        block = jax.lax.dynamic_index_in_dim(self.blocks, node + 1, keepdims=False)
        return block, jnp.where(node < 0, 0, FAN * node + self.first)


def wide_tree(tree: MeshTree) -> WideTree:
    """Makes the blocks of a tree with one triangle per leaf; raises TypeError for a tree with more of them in a leaf.

    No search finds the copies that fill its empty places.
    """
    if tree.leaf != 1:
        raise TypeError(f"{tree.leaf} triangles a leaf: expected 1")
    levels = [np.array(tree.levels[k]) for k in stored_levels(tree.depth)]
    levels[-1][np.asarray(tree.index) < 0] = nowhere(8)  # copies
    return WideTree(jax.device_put(blocks_of(levels)), len(levels[0]), len(levels))


def squared_distance_bounds(block: Array, point: Array) -> tuple[Array, Array]:
    """Lower and upper bounds (16,) on the squared distances from a point (3,) to the surface in discs (8, 16) [m^2]."""
    away = Vec3(*point) - Vec3(*block[:3])
    square, height = away.squared_norm(), jnp.abs(away.dot(Vec3(*block[3:6])))
    beside, lost = square - height * height, jnp.float32(CANCELLED) * square
    nearest = jnp.maximum(jnp.sqrt(jnp.maximum(beside - lost, 0)) - block[6], 0)
    farthest = jnp.sqrt(jnp.maximum(beside, 0) + lost) + block[6]
    low, high = jnp.maximum(height - block[7], 0), height + block[7]
    return nearest * nearest + low * low, farthest * farthest + high * high


# The search for the nearest triangle goes level by level. It keeps the nodes whose lower bound does not exceed the
# smallest upper bound so far, and compares the remaining triangles in full precision.


WIDTH = 1024  # capacity for candidate nodes and triangles: about ten times what an implant needs
LAST = 16  # triangles compared in full precision at a time


class NearestTriangle(NamedTuple):
    """The nearest triangle."""

    place: Array  # () int32, in the tree
    overflow: Array  # () bool: the list of candidates was full; the result may be wrong


def nearest_wide(tree: WideTree, triangles: Array, point: Vec3, half: int | None = None) -> NearestTriangle:
    """Finds the triangle (places, 9) [m], in the tree's order, nearest to a point of the mesh's frame [m].

    `half` is 0 or 1 to search only the first or the second half of the places. Supports jit and vmap; no derivatives.
    """
    return member_by_member(partial(_search_nearest, half))(tree, triangles, point.array())


def _search_nearest(half: int | None, tree: WideTree, rows: Array, point: Array) -> NearestTriangle:
    p = jax.lax.convert_element_type(point, jnp.float32)
    lanes = jnp.arange(FAN, dtype=jnp.int32)
    taken = (lanes >= tree.first // 2) == bool(half)

    def look(state: tuple[Array, ...]) -> tuple[Array, ...]:
        head, nodes, end, bound = state
        node = jax.lax.dynamic_index_in_dim(nodes, head, keepdims=False)
        block, first = tree.below(node)
        least, most = squared_distance_bounds(block, p)
        if half is not None:
            out = (node < 0) & ~taken
            least, most = jnp.where(out, jnp.inf, least), jnp.where(out, jnp.inf, most)
        bound = jnp.minimum(bound, jnp.min(most) * jnp.float32(1 + 4 * SLACK))
        nodes, end = written_where(nodes, end, WIDTH, least <= bound, lambda lane: first + lane)
        return head + 1, nodes, end, bound

    def more(state: tuple[Array, ...]) -> Array:
        head, nodes, end, _ = state
        node = jax.lax.dynamic_index_in_dim(nodes, head, keepdims=False)
        return (head < jnp.minimum(end, WIDTH)) & (node < tree.n_inner)

    zero = jnp.zeros((), jnp.int32)
    start = (zero, jnp.full(WIDTH + FAN, -1, jnp.int32), zero + 1, jnp.asarray(jnp.inf, jnp.float32))
    head, nodes, end, _ = jax.lax.while_loop(more, look, start)
    last = jnp.minimum(end, WIDTH)
    place = _nearest_in_stretch(rows, point, nodes - tree.n_inner, head, last)
    return NearestTriangle(place, (end > WIDTH) | (head >= last))


def _nearest_in_stretch(rows: Array, point: Array, places: Array, first: Array, end: Array) -> Array:
    """Place of the nearest triangle among list entries from `first` to `end`."""

    def compare(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        i, best, square = state
        some = jnp.maximum(jax.lax.dynamic_slice_in_dim(places, i, LAST), 0)
        p = Vec3(*(jnp.broadcast_to(point[k], (LAST,)) for k in range(3)))
        found = closest_on_triangle(Triangle.of_rows(rows[some]), p).square
        found = jnp.where(i + jnp.arange(LAST, dtype=jnp.int32) < end, found, jnp.inf)
        k = jnp.argmin(found)
        nearer = found[k] < square
        return i + LAST, jnp.where(nearer, some[k], best), jnp.where(nearer, found[k], square)

    start = (first, jnp.zeros((), jnp.int32), jnp.asarray(jnp.inf, point.dtype))
    return jax.lax.while_loop(lambda s: s[0] < end, compare, start)[1]


# A node wholly inside the ball is listed as one, with its sums; only triangles that the ball's surface may cut are
# listed individually. So the cost grows with the length of a contact's outline, not with its area.


class BallListLengths(NamedTuple):
    """Capacities of the lists of `InBall`."""

    cut: int  # triangles that the ball's surface may cut
    inside: int  # nodes wholly inside


class InBall(NamedTuple):
    """Triangles cut by a ball and nodes inside it, in lists of fixed length; entries past the count are meaningless."""

    cut: Array  # (room.cut,) int32: places of the triangles that the ball's surface may cut
    n_cut: Array  # () int32, may exceed the capacity
    inside: Array  # (room.inside,) int32: numbers of the nodes wholly inside
    n_inside: Array  # () int32

    def overflow(self) -> Array:
        """Whether entries were lost, () bool."""
        return (self.n_cut > self.cut.shape[0]) | (self.n_inside > self.inside.shape[0])


def in_ball(tree: WideTree, center: Vec3, radius: Scalar, room: BallListLengths) -> InBall:
    """Finds what is inside a ball, its centre [m] in the mesh's frame. Supports jit and vmap; no derivatives."""
    ball = jnp.stack([jnp.asarray(a, jnp.float32) for a in (center.x, center.y, center.z, radius)])
    return member_by_member(partial(_search_ball, room))(tree, ball)


def _search_ball(room: BallListLengths, tree: WideTree, ball: Array) -> InBall:
    # One array for both lists, nodes inside after those still to visit: XLA copies a second array in every iteration.
    shelf = 2 * room.cut + 2 * FAN  # half of it for inner nodes
    size = shelf + room.inside + FAN
    square_radius = ball[3] * ball[3]

    def look(state: tuple[Array, ...]) -> tuple[Array, ...]:
        head, lists, end, inside_end = state
        block, first = tree.below(jax.lax.dynamic_index_in_dim(lists, head, keepdims=False))
        least, most = squared_distance_bounds(block, ball[:3])
        inside = most <= jnp.float32(1 - 2 * SLACK) * square_radius
        touched = least <= jnp.float32(1 + 2 * SLACK) * square_radius
        lists, end = written_where(lists, end, shelf - FAN, touched & ~inside, lambda lane: first + lane)
        lists, inside_end = written_where(lists, inside_end, size - FAN, inside, lambda lane: first + lane)
        return head + 1, lists, end, inside_end

    def more(state: tuple[Array, ...]) -> Array:
        head, lists, end, _ = state
        node = jax.lax.dynamic_index_in_dim(lists, head, keepdims=False)
        return (head < jnp.minimum(end, shelf - FAN)) & (node < tree.n_inner)

    zero = jnp.zeros((), jnp.int32)
    start = (zero, jnp.full(size, -1, jnp.int32), zero + 1, zero + shelf)
    head, lists, end, inside_end = jax.lax.while_loop(more, look, start)
    cut = jax.lax.dynamic_slice_in_dim(lists, head, room.cut) - tree.n_inner
    # If inner nodes filled the list, triangles are missing from it.
    n_cut = jnp.where(end > shelf - FAN, room.cut + 1, end - head)
    valid = jnp.arange(room.cut, dtype=jnp.int32) < n_cut
    n_inside = inside_end - shelf
    listed = jnp.arange(room.inside, dtype=jnp.int32) < n_inside
    inside = jnp.where(listed, lists[shelf : shelf + room.inside], 0)
    return InBall(jnp.where(valid, cut, 0), n_cut, inside, n_inside)
