"""Lists of fixed capacity for JAX loops, which grow by up to sixteen entries at a time (stream compaction).

Sixteen conditions are packed into two bytes. A table gives the positions of a byte's ones; eight entries are written
at once, and the next write overwrites the surplus. Each list is a single array: if a loop writes several arrays, XLA's
CPU compiler may copy them whole in every iteration.
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


# For every byte: its bits, the positions of its ones in order, and their number.
_BITS = (np.arange(256)[:, None] >> np.arange(_BYTE)) & 1
_PLACES, _COUNT = np.argsort(1 - _BITS, axis=1, kind="stable").astype(np.int32), _BITS.sum(axis=1).astype(np.int32)
_WEIGHTS = (1 << np.arange(_BYTE)).astype(np.int32)


class Queue(NamedTuple):
    """A list of fixed capacity; entries past the count are meaningless."""

    entries: Array  # (width + 8,)
    count: Array  # () int32: number of entries added, which may exceed the capacity

    @property
    def width(self) -> int:
        """Capacity."""
        return self.entries.shape[0] - _BYTE

    @property
    def length(self) -> Array:
        """Number of valid entries, () int32."""
        return jnp.minimum(self.count, jnp.asarray(self.width, jnp.int32))

    @property
    def overflow(self) -> Array:
        """Whether entries were lost."""
        return self.count > self.width


def queue_of(width: int, first: Array | None = None, dtype: jnp.dtype = jnp.int32) -> Queue:
    """Makes a queue of a capacity, empty or with the entries `first` (n,)."""
    n = 0 if first is None else first.shape[0]
    entries = jnp.zeros(max(width, n) + _BYTE, dtype)
    if first is not None:
        entries = jax.lax.dynamic_update_slice(entries, first.astype(dtype), (jnp.zeros((), jnp.int32),))
    return Queue(entries, jnp.asarray(n, jnp.int32))


def pushed_where(queue: Queue, yes: Array, value_of: Callable[[Array], Array]) -> Queue:
    """Appends `value_of(lanes)` for those of sixteen lanes (bool of any shape) whose condition is true.

    `value_of` maps lane numbers (8,) int32 to values (8,).
    """
    return Queue(*written_where(queue.entries, queue.count, queue.width, yes, value_of))


def written_where(
    entries: Array, at: Array, last: int, yes: Array, value_of: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Writes the values of those of sixteen lanes whose condition is true to a list from position `at` on.

    Returns the list and the position after the last value. `last` is the capacity; the list is eight entries longer.
    """
    bits = yes.reshape(LANES).astype(jnp.int32)
    end, places, counts = (jnp.asarray(x, jnp.int32) for x in (last, _PLACES, _COUNT))
    for first in range(0, LANES, _BYTE):
        byte = jnp.sum(bits[first : first + _BYTE] * jnp.asarray(_WEIGHTS), dtype=jnp.int32)
        lanes = jax.lax.dynamic_index_in_dim(places, byte, 0, keepdims=False) + jnp.asarray(first, jnp.int32)
        entries = jax.lax.dynamic_update_slice(entries, value_of(lanes).astype(entries.dtype), (jnp.minimum(at, end),))
        at = at + jax.lax.dynamic_index_in_dim(counts, byte, 0, keepdims=False)
    return entries, at


# Under vmap a loop runs as long as its slowest element needs, and every iteration works on all elements with masks. So
# on a CPU the elements of a batch run one after the other; elsewhere the batch runs at once. Results are stacked as one
# array per dtype: with more arrays, XLA's CPU compiler fuses their writes into code that for every element goes over
# all elements' results.


@custom_vmap
def most_in_batch(count: Array) -> Array:
    """Largest count () in the batch, the same for all its elements, so that what depends on it alone needs no masks."""
    return count


@most_in_batch.def_vmap
def _most_of_all(_size: int, _is_batched: Any, counts: Array) -> tuple[Array, bool]:
    return most_in_batch(jnp.max(counts, axis=0)), False


Packed = dict[str, Array]  # by dtype


def member_by_member(search: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps a search: its result has no derivatives, and on a CPU vmap runs it for one element at a time."""
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
    """Concatenates all leaves of one dtype."""
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
