"""Depth-first traversal of the leaves of a tree that may be nearer than a limit, which visited leaves may lower.

It visits one node after the other: XLA compiles such a loop to a single function on a CPU. Under vmap it would run as
long as the slowest element needs; see `pftwin.geometry.bvh.loops`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.spatial import Vec3
from pftwin.geometry.bvh.loops import written_where
from pftwin.geometry.bvh.tree import ROUNDING, depth_for, disc_distances, tree_arrays

FAN = 16  # children per node
T = TypeVar("T")
SearchTree = tuple[Array, Array, Array]
STACK = 11 * FAN  # ten nested fans, for two million triangles, and room for the surplus of a write of eight
SLACK = 1e-5  # bound on the relative error of distances in single precision


def walk(tree: SearchTree, point: Vec3, limit: Callable[[T], Array], at_leaf: Callable[[T, Array], T], start: T) -> T:
    """Folds `at_leaf` over the leaves within a limit of a point, a node's nearest child first; returns the last state.

    Args:
        tree: bounds of each node's children (nodes, 8, 16), the same one child per row (16 nodes, 8), and `Fans.first`.
        point: from which distances are measured [m].
        limit: function of the state; nodes farther away than this [m] are skipped; finite.
        at_leaf: function of the state and a leaf's number that returns the new state.
        start: initial state.
    """
    (bounds, rows, first), at = tree, point.array().astype(jnp.float32)
    inner = jnp.int32(first.shape[0])

    def within(away: Array, known: T) -> Array:
        return away <= limit(known).astype(away.dtype) * (1 + SLACK)

    def open_fan(stack: Array, top: Array, known: T, node: Array) -> tuple[Array, Array, T]:
        away = disc_distances(jax.lax.dynamic_index_in_dim(bounds, node, keepdims=False).T, at)
        near = within(away, known)
        # The nearest is pushed last, so that it is visited first.
        best = jnp.argmin(away).astype(jnp.int32)
        others = near & (jnp.arange(FAN, dtype=jnp.int32) != best)
        stack, top = written_where(stack, top, STACK - FAN // 2, others, lambda lane: FAN * node + lane)
        stack = jax.lax.dynamic_update_index_in_dim(stack, FAN * node + best, top, 0)
        return stack, top + near[best].astype(jnp.int32), known

    def step(now: tuple[Array, Array, T]) -> tuple[Array, Array, T]:
        stack, top, known = now
        child, top = stack[top - 1], top - 1
        number = first[child // FAN] + child % FAN
        still = within(disc_distances(jax.lax.dynamic_index_in_dim(rows, child, keepdims=False), at), known)
        return jax.lax.switch(
            jnp.where(still, jnp.where(number < inner, jnp.int32(1), jnp.int32(2)), jnp.int32(0)),
            (
                lambda s: s,
                lambda s: open_fan(s[0], s[1], s[2], number),
                lambda s: (s[0], s[1], at_leaf(s[2], number - inner)),
            ),
            (stack, top, known),
        )

    begin = open_fan(jnp.zeros(STACK, jnp.int32), jnp.int32(0), start, jnp.int32(0))
    return jax.lax.while_loop(lambda now: now[1] > 0, step, begin)[2]


STRIDE = 4  # levels of the binary tree per fan
FAR = 1e15  # [m] coordinate of unused lanes


class Fans(NamedTuple):
    """A sixteen-way tree: every fourth level of a complete binary tree (see `bvh.tree`)."""

    bounds: NDArray[np.float32]  # (inner nodes, 8, 16) of the children: discs, or balls (4 rows instead of 8)
    first: NDArray[np.int32]  # (inner nodes,) number of the first child
    places: NDArray[np.int32]  # (leaves, lanes) triangle; in an empty lane, which holds a copy, -1 - the copied one


def fans_of(corners: NDArray[np.float64], lanes: int, balls: bool) -> Fans:
    """Builds the tree of triangles with corners (n, 3, 3) [m].

    A leaf has at most `lanes` triangles; leaves have as many lanes as the fullest needs. With `balls` it bounds the
    triangles' centroids by balls (middle and radius); else their corners by discs.
    """
    depth = depth_for(len(corners), lanes)
    used = -(-len(corners) // 2**depth)  # triangles in the fullest leaf: splits halve to within one
    triangles, index, discs = tree_arrays(corners, used, depth)
    margin = ROUNDING * float(np.abs(corners).max())
    middles = triangles.reshape(-1, 3, 3).mean(axis=1)
    tables = [_balls(middles.reshape(2**k, -1, 3), margin) if balls else discs[k] for k in stored_levels(depth)]
    bounds = blocks_of(tables)
    below = 1 + len(tables[0]) + FAN * np.arange(len(bounds) - 1)  # first children; the root is node 0, its own is 1
    return Fans(bounds, np.concatenate([[1], below]).astype(np.int32), index.reshape(-1, used))


def stored_levels(depth: int) -> range:
    """Every fourth level of a binary tree of a depth, including the leaves."""
    return range(depth % STRIDE or min(STRIDE, depth), depth + 1, STRIDE)


def blocks_of(levels: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Bounds (nodes, 8 or 4, 16) of nodes' children, level by level, from those of the stored levels (2^l, 8 or 4)."""
    top = np.tile(nowhere(levels[0].shape[1]), (FAN, 1))
    top[: len(levels[0])] = levels[0]
    blocks = np.concatenate([level.reshape(-1, FAN, level.shape[1]) for level in (top, *levels[1:])])
    return np.ascontiguousarray(blocks.swapaxes(1, 2))


def nowhere(size: int) -> NDArray[np.float32]:
    """A bound (size,) so far away that no search reaches it."""
    return FAR * np.eye(1, size, dtype=np.float32)[0]


def rows_of(fans: Fans) -> NDArray[np.float32]:
    """The bounds, one child per row, (16 nodes, 8 or 4)."""
    return np.ascontiguousarray(fans.bounds.swapaxes(1, 2)).reshape(-1, fans.bounds.shape[1])


def _balls(points: NDArray[np.float64], margin: float) -> NDArray[np.float32]:
    """Middle and radius (nodes, 4) of balls around points (nodes, k, 3)."""
    middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
    middle = middle.astype(np.float32)
    radius = np.linalg.norm(points - middle[:, None].astype(np.float64), axis=2).max(axis=1) + margin
    return np.concatenate([middle, radius[:, None].astype(np.float32)], axis=1)
