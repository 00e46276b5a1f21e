"""From masks to the places where they are true, in lists of fixed length."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array


class Places(NamedTuple):
    """A list of fixed length; entries past the count are 0 and mean nothing."""

    index: Array  # (width,) int32
    total: Array  # () int32: how many there were, which may be more than the list holds

    def valid(self) -> Array:
        """Which entries count, (width,)."""
        return jnp.arange(self.index.shape[0], dtype=jnp.int32) < self.total

    def overflow(self) -> Array:
        """Whether some were lost."""
        return self.total > self.index.shape[0]


def empty(width: int) -> Places:
    """A list without entries."""
    return Places(jnp.zeros(width, jnp.int32), jnp.zeros((), jnp.int32))


def appended(places: Places, mask: Array, first: Array | int = 0) -> Places:
    """The list with the places (n,) where a mask is true, counted from `first`, at its end.

    A loop over the mask: on a CPU about two nanoseconds an entry, where sorting takes tens.
    """
    width = places.index.shape[0]
    first = jnp.asarray(first, jnp.int32)

    def put(i: Array, so_far: tuple[Array, Array]) -> tuple[Array, Array]:
        index, total = so_far
        # One place more than asked for takes what is written past the end.
        index = jax.lax.dynamic_update_index_in_dim(index, first + i, jnp.minimum(total, width), 0)
        return index, total + mask[i].astype(jnp.int32)

    room = jnp.concatenate([places.index, jnp.zeros(1, jnp.int32)])
    n = jnp.asarray(mask.shape[0], jnp.int32)
    index, total = jax.lax.fori_loop(jnp.zeros((), jnp.int32), n, put, (room, places.total))
    listed = jnp.arange(width, dtype=jnp.int32) < total
    return Places(jnp.where(listed, index[:width], 0), total)


def compacted(mask: Array, width: int) -> Places:
    """The first `width` places (n,) where a mask is true."""
    return appended(empty(width), mask)
