"""Which triangle of a mesh, or of its medial or lateral half, is nearest to a point.

Node by node, level after level: of a node's sixteen descendants those stay in the race whose least distance is not
above the smallest of all largest ones met so far. Of the triangles that are left the nearest is taken, in full
precision: the brute force's answer.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Vec3
from pftwin.geometry.bvh.members import member_by_member
from pftwin.geometry.bvh.queue import written_where
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.wide import FAN, SLACK, WideTree, squares

WIDTH = 1024  # nodes and triangles that may stay in the race: some ten times what an implant asks for
LAST = 16  # triangles compared in full precision at a time


class NearestTriangle(NamedTuple):
    """The nearest triangle."""

    place: Array  # () int32, in the tree
    overflow: Array  # () bool: more were in the race than there was room for; the answer may be wrong


def nearest_wide(
    tree: WideTree, triangles: Array, point: Vec3, half: int | None = None, *, width: int | None = None
) -> NearestTriangle:
    """The triangle nearest to a point of the mesh's frame. Nothing here is differentiated.

    Args:
        tree: of the mesh.
        triangles: (places, 9) in the tree's order [m].
        point: in the mesh's frame [m].
        half: 0 or 1: of all triangles those in the first or the second half of the places.
        width: room for nodes and triangles; None: `WIDTH`.
    """
    room = WIDTH if width is None else width
    return member_by_member(partial(_search, half, room))(tree, triangles, jnp.stack([point.x, point.y, point.z]))


def _search(half: int | None, room: int, tree: WideTree, rows: Array, point: Array) -> NearestTriangle:
    p = jax.lax.convert_element_type(point, jnp.float32)
    lanes = jnp.arange(FAN, dtype=jnp.int32)
    taken = (lanes >= tree.first // 2) == bool(half)

    def look(state: tuple[Array, ...]) -> tuple[Array, ...]:
        head, nodes, end, bound = state
        node = jax.lax.dynamic_index_in_dim(nodes, head, keepdims=False)
        block, first = tree.below(node)
        least, most = squares(block, p)
        if half is not None:
            out = (node < 0) & ~taken
            least, most = jnp.where(out, jnp.inf, least), jnp.where(out, jnp.inf, most)
        bound = jnp.minimum(bound, jnp.min(most) * jnp.float32(1 + 4 * SLACK))
        nodes, end = written_where(nodes, end, room, least <= bound, lambda lane: first + lane)
        return head + 1, nodes, end, bound

    def more(state: tuple[Array, ...]) -> Array:
        head, nodes, end, _ = state
        node = jax.lax.dynamic_index_in_dim(nodes, head, keepdims=False)
        return (head < jnp.minimum(end, room)) & (node < tree.n_inner)

    zero = jnp.zeros((), jnp.int32)
    start = (zero, jnp.full(room + FAN, -1, jnp.int32), zero + 1, jnp.asarray(jnp.inf, jnp.float32))
    head, nodes, end, _ = jax.lax.while_loop(more, look, start)
    last = jnp.minimum(end, room)
    place, _ = _among(rows, point, nodes - tree.n_inner, head, last)
    return NearestTriangle(place, (end > room) | (head >= last))


def _among(rows: Array, point: Array, places: Array, first: Array, end: Array) -> tuple[Array, Array]:
    """The place of the nearest triangle of a stretch of a list, and the square of its distance."""

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
    return jax.lax.while_loop(lambda s: s[0] < end, compare, start)[1:]
