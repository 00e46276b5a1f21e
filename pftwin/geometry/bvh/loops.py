"""Lists that grow by up to sixteen entries at a time, for loops that a compiler makes one function of.

Which of sixteen answers are yes is packed into two bytes; a table turns a byte into the places of its ones, which are
written in one go, and the next write overwrites what was too much. One array a list: with several written in one loop
XLA's CPU compiler may copy them whole at every turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.lax import stop_gradient
from jaxtyping import Array

LANES = 16
_BYTE = 8


# For every byte its bits, the places of its ones in order, and their number.
_BITS = (np.arange(256)[:, None] >> np.arange(_BYTE)) & 1
_PLACES, _COUNT = np.argsort(1 - _BITS, axis=1, kind="stable").astype(np.int32), _BITS.sum(axis=1).astype(np.int32)
_WEIGHTS = (1 << np.arange(_BYTE)).astype(np.int32)


class Queue(NamedTuple):
    """Entries up to the count; later ones are meaningless."""

    entries: Array  # (width + 8,) integers
    count: Array  # () int32: how many were added, which may exceed the capacity

    @property
    def width(self) -> int:
        """Entries that there is room for."""
        return self.entries.shape[0] - _BYTE

    @property
    def length(self) -> Array:
        """Entries that can be read, () int32."""
        return jnp.minimum(self.count, jnp.asarray(self.width, jnp.int32))

    @property
    def overflow(self) -> Array:
        """Whether some were lost."""
        return self.count > self.width


def queue_of(width: int, first: Array | None = None, dtype: jnp.dtype = jnp.int32) -> Queue:
    """A queue that is empty, or holds the `first` entries (n,)."""
    n = 0 if first is None else first.shape[0]
    entries = jnp.zeros(max(width, n) + _BYTE, dtype)
    if first is not None:
        entries = jax.lax.dynamic_update_slice(entries, first.astype(dtype), (jnp.zeros((), jnp.int32),))
    return Queue(entries, jnp.asarray(n, jnp.int32))


def pushed_where(queue: Queue, yes: Array, value_of: Callable[[Array], Array]) -> Queue:
    """The queue with the values of those of sixteen lanes that are true at its end.

    Args:
        queue: to write to.
        yes: (16,) bool.
        value_of: the values (8,) of lanes (8,), int32.
    """
    return Queue(*written_where(queue.entries, queue.count, queue.width, yes, value_of))


def written_where(
    entries: Array, at: Array, last: int, yes: Array, value_of: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """A list with the values of those of sixteen lanes that are true from a place on, and the place after them.

    Past the place `last` nothing of use is written; the list has eight more.
    """
    bits = yes.reshape(LANES).astype(jnp.int32)
    end, places, counts = (jnp.asarray(x, jnp.int32) for x in (last, _PLACES, _COUNT))
    for first in range(0, LANES, _BYTE):
        byte = jnp.sum(bits[first : first + _BYTE] * jnp.asarray(_WEIGHTS), dtype=jnp.int32)
        lanes = jax.lax.dynamic_index_in_dim(places, byte, 0, keepdims=False) + jnp.asarray(first, jnp.int32)
        entries = jax.lax.dynamic_update_slice(entries, value_of(lanes).astype(entries.dtype), (jnp.minimum(at, end),))
        at = at + jax.lax.dynamic_index_in_dim(counts, byte, 0, keepdims=False)
    return entries, at


# A loop that ends when its own list does is fast alone. Mapped over a batch it turns to the slowest member's end, and
# every turn works on all members with masks. So on a CPU members take turns; elsewhere a batch runs at once.
# Answers are stacked as one array for each type of number: with several, XLA's CPU compiler joins what writes them to
# one piece of code that goes over all members' answers for every member.


@custom_vmap
def most_in_batch(count: Array) -> Array:
    """The largest of a batch's counts (), the same for every member: what depends on it alone needs no masks."""
    return count


@most_in_batch.def_vmap
def _most_of_all(_size: int, _is_batched: Any, counts: Array) -> tuple[Array, bool]:
    return most_in_batch(jnp.max(counts, axis=0)), False


Packed = dict[str, Array]  # by the type of number


def member_by_member(search: Callable[..., Any]) -> Callable[..., Any]:
    """A search whose answer is not differentiated, and which in a batch on a CPU runs for one member at a time."""
    if jax.default_backend() == "cpu":
        search = _in_turns(search)
    return lambda *args: search(*stop_gradient(args))


def _in_turns(search: Callable[..., Any]) -> Callable[..., Any]:
    turns = custom_vmap(search)

    @turns.def_vmap
    def batch(_size: int, is_batched: Any, *args: Any) -> tuple[Any, Any]:
        batched, same = eqx.partition(args, tuple(is_batched))

        def member(own: Any) -> Any:
            return turns(*eqx.combine(own, same))

        one = jax.eval_shape(member, jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), batched))
        stacked = jax.lax.map(lambda own: _pack_leaves(member(own)), batched)
        return jax.vmap(lambda numbers: _unpacked(numbers, one))(stacked), jax.tree.map(lambda _: True, one)

    return turns


def _pack_leaves(answer: Any) -> Packed:
    """All leaves of one type as one array."""
    kinds: dict[str, list[Array]] = {}
    for x in jax.tree.leaves(answer):
        kinds.setdefault(x.dtype.name, []).append(x.reshape(-1))
    return {kind: jnp.concatenate(parts) for kind, parts in kinds.items()}


def _unpacked(numbers: Packed, like: Any) -> Any:
    leaves, structure = jax.tree.flatten(like)
    starts = dict.fromkeys(numbers, 0)
    parts = []
    for x in leaves:
        start, kind = starts[x.dtype.name], x.dtype.name
        starts[kind] = start + math.prod(x.shape)
        parts.append(numbers[kind][start : starts[kind]].reshape(x.shape))
    return structure.unflatten(parts)
