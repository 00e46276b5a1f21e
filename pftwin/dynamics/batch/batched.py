"""`vmap` in pieces of a size that suits the processor.

A step reads and writes hundreds of arrays of the length of a piece, which are consecutive in memory. A piece of about a
hundred variants fits into a core's second-level cache, and pieces run one after the other. If the length is a large
power of two, the same element of all arrays maps to the same few cache lines (4 KiB aliasing), so such pieces are
padded with a few unused variants. An accelerator has thousands of lanes and launches every operation of a step
separately: on an H200 a step of 131,000 variants takes four times as long as one of 2,000.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

PIECE = 120  # largest number of variants in a piece
ACCELERATED = 131_072  # the same on an accelerator
ALIASING = 64  # sizes that are multiples of this are avoided
FILL = 8  # number of variants added to such a size: one vector register of float64


def good_sizes(n: int, platform: str | None = None) -> tuple[int, int]:
    """Number and size of the pieces for a batch; together they contain at least n variants.

    Args:
        n: number of variants.
        platform: platform of the devices; by default JAX's.
    """
    on_cpu = (platform or jax.default_backend()) == "cpu"
    pieces = max(1, -(-n // (PIECE if on_cpu else ACCELERATED)))
    size = -(-n // pieces)
    return pieces, size + FILL if on_cpu and size % ALIASING == 0 and size > 0 else size


def batched(function: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.vmap(function)` over the leading axis of all arrays in all arguments, in pieces of a suitable size."""

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
