"""A walk down a tree of fans: every leaf that may hold what is nearer than a limit, which the leaves may lower.

One node after the other, as in C: XLA makes a single function of such a loop on a CPU. Under vmap it would run to the
slowest member and lose that; batches go through `jax.custom_batching.sequential_vmap`, which see.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.surfaces.depth_fans import FAN

T = TypeVar("T")
DEEP = 10  # fans on top of each other: more than two million triangles
SLACK = 1e-5  # share of a distance by which single precision may be off

_BITS = np.array([[1 << k for k in range(8)]], dtype=np.int32)
_COUNTS = np.array([bin(i).count("1") for i in range(256)], dtype=np.int32)
_SET = np.array([([k for k in range(8) if i >> k & 1] + [0] * 8)[:8] for i in range(256)], dtype=np.int32)


def room() -> int:
    """Of a stack of nodes: a node goes, sixteen come; and what a write of eight may spill."""
    return DEEP * FAN + FAN


def pushed(stack: Array, top: Array, first: Array, mask: Array) -> tuple[Array, Array]:
    """A stack with those of the sixteen nodes from the number `first` on it whose mask is set."""
    bits, counts, places = jnp.asarray(_BITS), jnp.asarray(_COUNTS), jnp.asarray(_SET)
    for half in (0, 1):
        code = jnp.sum(mask[8 * half : 8 * half + 8].astype(jnp.int32) * bits[0], dtype=jnp.int32)
        stack = jax.lax.dynamic_update_slice_in_dim(stack, places[code] + (first + jnp.int32(8 * half)), top, 0)
        top = top + counts[code]
    return stack, top


def walk(
    bounds: Array,
    first: Array,
    distances: Callable[[Array], Array],
    limit: Callable[[T], Array],
    at_leaf: Callable[[T, Array], T],
    start: T,
) -> T:
    """What the leaves made of `start`, the nearest child of a node before its siblings.

    Args:
        bounds, first: of the tree; see `Fans`.
        distances: from the bounds of a fan (8, 16) to the least distances (16,).
        limit: nodes farther away are left out, as far as is known when they are looked at.
        at_leaf: from what is known and a leaf's number to what is known then.
        start: what is known.
    """
    inner = jnp.int32(first.shape[0])

    def open_fan(now: tuple[Array, Array, T], node: Array) -> tuple[Array, Array, T]:
        stack, top, known = now
        away = distances(jax.lax.dynamic_index_in_dim(bounds, node, keepdims=False))
        near = away <= limit(known).astype(away.dtype) * (1 + SLACK)
        child = jax.lax.dynamic_index_in_dim(first, node, keepdims=False)
        # The nearest last, so that it is looked at first.
        best = jnp.argmin(away).astype(jnp.int32)
        others = near & (jnp.arange(FAN, dtype=jnp.int32) != best)
        stack, top = pushed(stack, top, child, others)
        stack = jax.lax.dynamic_update_index_in_dim(stack, child + best, top, 0)
        return stack, top + near[best].astype(jnp.int32), known

    def step(now: tuple[Array, Array, T]) -> tuple[Array, Array, T]:
        stack, top, known = now
        node, top = stack[top - 1], top - 1
        return jax.lax.cond(
            node < inner,
            lambda s: open_fan(s, node),
            lambda s: (s[0], s[1], at_leaf(s[2], node - inner)),
            (stack, top, known),
        )

    stack = jnp.zeros(room(), jnp.int32)
    return jax.lax.while_loop(lambda now: now[1] > 0, step, (stack, jnp.int32(1), start))[2]
