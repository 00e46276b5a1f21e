"""Many variants side by side, in pieces that suit the processor's cache.

A step reads and writes hundreds of arrays of a piece's length, one behind the other in memory. A piece of some hundred
variants stays in a core's second-level cache; pieces follow one another. Where the length is a large power of two, the
same element of all arrays falls on the same few lines of the cache (4 KiB aliasing), so such pieces are filled up by a
few members nobody sees.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

PIECE = 120  # most variants of a piece
ALIASING = 64  # elements: multiples of it are avoided
FILL = 8  # members added: one vector register of float64


def good_sizes(n: int) -> tuple[int, int]:
    """How many pieces a batch of n is best computed in, and their size: together at least n."""
    pieces = max(1, -(-n // PIECE))
    size = -(-n // pieces)
    return pieces, size + FILL if size % ALIASING == 0 and size > 0 else size


def batched(function: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.vmap(function)` over the leading axis of every array of every argument, in pieces of a good size. Pure."""

    def run(*args: Any) -> Any:
        n = jax.tree.leaves(args)[0].shape[0]
        pieces, size = good_sizes(n)
        fill = pieces * size - n
        if fill:
            args = jax.tree.map(lambda a: jnp.concatenate([a, jnp.repeat(a[-1:], fill, axis=0)]), args)
        if pieces == 1:
            out = jax.vmap(function)(*args)
        else:
            split = jax.tree.map(lambda a: a.reshape(pieces, size, *a.shape[1:]), args)
            out = jax.lax.map(lambda some: jax.vmap(function)(*some), split)
            out = jax.tree.map(lambda a: a.reshape(pieces * size, *a.shape[2:]), out)
        return jax.tree.map(lambda a: a[:n], out) if fill else out

    return run
