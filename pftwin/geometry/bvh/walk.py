"""Visits every leaf of a tree that may be nearer than a limit, which the leaves may lower.

One node after the other, as in C: XLA makes a single function of such a loop on a CPU. Under vmap it would run to the
slowest member and lose that; see `pftwin.geometry.bvh.loops`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.geometry.bvh.loops import written_where
from pftwin.geometry.bvh.tree import ROUNDING, depth_for, tree_arrays

FAN = 16  # children of a node
T = TypeVar("T")
DEEP = 10  # fans on top of each other: more than two million triangles
SLACK = 1e-5  # share of a distance by which single precision may be off


def stack_size() -> int:
    """Of a stack of nodes: a node goes, sixteen come; and what a write of eight may spill."""
    return DEEP * FAN + FAN


def push_children(stack: Array, top: Array, first: Array, mask: Array) -> tuple[Array, Array]:
    """A stack with those of the sixteen nodes from the number `first` on it whose mask is set."""
    return written_where(stack, top, stack.shape[0] - FAN // 2, mask, lambda lane: first + lane)


def walk(
    bounds: Array,
    rows: Array,
    first: Array,
    distances: Callable[[Array], Array],
    limit: Callable[[T], Array],
    at_leaf: Callable[[T, Array], T],
    start: T,
) -> T:
    """Folds `at_leaf` over the leaves within the limit, from `start`; the nearest child of a node comes first.

    Args:
        bounds, rows, first: of the tree; see `Fans`.
        distances: from bounds (..., 8) to the least distances (...).
        limit: nodes farther away are left out, as far as is known when they are looked at; finite.
        at_leaf: from what is known and a leaf's number to what is known then.
        start: what is known.
    """
    inner = jnp.int32(first.shape[0])

    def within(away: Array, known: T) -> Array:
        return away <= limit(known).astype(away.dtype) * (1 + SLACK)

    def open_fan(stack: Array, top: Array, known: T, node: Array) -> tuple[Array, Array, T]:
        away = distances(jax.lax.dynamic_index_in_dim(bounds, node, keepdims=False).T)
        near = within(away, known)
        # The nearest last, so that it is looked at first.
        best = jnp.argmin(away).astype(jnp.int32)
        others = near & (jnp.arange(FAN, dtype=jnp.int32) != best)
        stack, top = push_children(stack, top, FAN * node, others)
        stack = jax.lax.dynamic_update_index_in_dim(stack, FAN * node + best, top, 0)
        return stack, top + near[best].astype(jnp.int32), known

    def step(now: tuple[Array, Array, T]) -> tuple[Array, Array, T]:
        stack, top, known = now
        child, top = stack[top - 1], top - 1
        number = first[child // FAN] + child % FAN
        still = within(distances(jax.lax.dynamic_index_in_dim(rows, child, keepdims=False)), known)
        return jax.lax.switch(
            jnp.where(still, jnp.where(number < inner, jnp.int32(1), jnp.int32(2)), jnp.int32(0)),
            (
                lambda s: s,
                lambda s: open_fan(s[0], s[1], s[2], number),
                lambda s: (s[0], s[1], at_leaf(s[2], number - inner)),
            ),
            (stack, top, known),
        )

    begin = open_fan(jnp.zeros(stack_size(), jnp.int32), jnp.int32(0), start, jnp.int32(0))
    return jax.lax.while_loop(lambda now: now[1] > 0, step, begin)[2]


STRIDE = 4  # binary levels in a fan
FAR = 1e15  # [m] where dead lanes are


class Fans(NamedTuple):
    """A complete binary tree (see `bvh.tree`), every fourth level of it kept."""

    bounds: NDArray[np.float32]  # (nodes with children, 8, 16) of the children: discs, or balls (4 numbers)
    first: NDArray[np.int32]  # (nodes with children,) the first child's number
    places: NDArray[np.int32]  # (leaves, lanes) which triangle; -1 - the original in an empty lane, which holds a copy


def fans_of(corners: NDArray[np.float64], lanes: int, balls: bool) -> Fans:
    """The tree of triangles (n, 3, 3) [m] with at most `lanes` in a leaf.

    Args:
        corners: of the triangles.
        lanes: most triangles in a leaf; as many lanes are used as the fullest needs.
        balls: bounds are balls about the triangles' centroids: middle and radius; else discs about their corners.
    """
    depth = depth_for(len(corners), lanes)
    used = -(-len(corners) // 2**depth)  # in the fullest leaf: splits halve to within one
    triangles, index, discs = tree_arrays(corners, used, depth)
    first_level = depth if depth < STRIDE else depth % STRIDE or STRIDE
    levels = list(range(first_level, depth + 1, STRIDE))
    margin = ROUNDING * float(np.abs(corners).max())
    middles = triangles.reshape(-1, 3, 3).mean(axis=1)
    tables = [_balls(middles.reshape(2**k, -1, 3), margin) if balls else discs[k] for k in levels]
    root = np.zeros((FAN, tables[0].shape[1]), dtype=np.float32)
    root[:, 0] = FAR
    root[: len(tables[0])] = tables[0]
    rows = [root, *tables[1:]]
    bounds = np.concatenate([r.reshape(-1, FAN, r.shape[1]) for r in rows])
    parents = [1, *(2**level for level in levels[:-1])]
    begins = np.cumsum([1, *(2**level for level in levels)])[: len(levels)]  # each level's first number
    steps = [np.arange(k) * FAN + b for k, b in zip(parents, begins, strict=True)]
    return Fans(
        np.ascontiguousarray(bounds.swapaxes(1, 2)), np.concatenate(steps).astype(np.int32), index.reshape(-1, used)
    )


def rows_of(fans: Fans) -> NDArray[np.float32]:
    """The bounds child after child, (16 nodes, 8 or 4)."""
    return np.ascontiguousarray(fans.bounds.swapaxes(1, 2)).reshape(-1, fans.bounds.shape[1])


def _balls(points: NDArray[np.float64], margin: float) -> NDArray[np.float32]:
    """Middle and radius (nodes, 4) of points (nodes, k, 3)."""
    middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
    middle = middle.astype(np.float32)
    radius = np.linalg.norm(points - middle[:, None].astype(np.float64), axis=2).max(axis=1) + margin
    return np.concatenate([middle, radius[:, None].astype(np.float32)], axis=1)
