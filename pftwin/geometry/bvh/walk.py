"""A walk down a tree of fans: every leaf that may hold what is nearer than a limit, which the leaves may lower.

One node after the other, as in C: XLA makes a single function of such a loop on a CPU. Under vmap it would run to the
slowest member and lose that; see `pftwin.geometry.bvh.members`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.geometry.bvh.fans import FAN
from pftwin.geometry.bvh.queue import written_where

T = TypeVar("T")
DEEP = 10  # fans on top of each other: more than two million triangles
SLACK = 1e-5  # share of a distance by which single precision may be off


def room() -> int:
    """Of a stack of nodes: a node goes, sixteen come; and what a write of eight may spill."""
    return DEEP * FAN + FAN


def pushed(stack: Array, top: Array, first: Array, mask: Array) -> tuple[Array, Array]:
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
    """What the leaves made of `start`, the nearest child of a node before its siblings.

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
        stack, top = pushed(stack, top, FAN * node, others)
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

    begin = open_fan(jnp.zeros(room(), jnp.int32), jnp.int32(0), start, jnp.int32(0))
    return jax.lax.while_loop(lambda now: now[1] > 0, step, begin)[2]
