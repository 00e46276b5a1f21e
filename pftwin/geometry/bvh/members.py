"""Searches in a batch: on a CPU one member after the other.

A loop that ends when its own list does is fast alone. Mapped over a batch it turns to the slowest member's end, and
every turn works on all members with masks. One after the other each runs at its own speed; elsewhere than on a CPU, a
batch that is worked on at once wins.

Answers are stacked as one array for each type of number. With several, XLA's CPU compiler joins what writes them to one
piece of code that goes over all members' answers for every member.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.lax import stop_gradient
from jaxtyping import Array

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
        leaves, structure = jax.tree.flatten(args)
        flags = jax.tree.leaves(is_batched)

        def member(own: list[Array]) -> Any:
            next_own = iter(own)
            return turns(*structure.unflatten([next(next_own) if f else x for x, f in zip(leaves, flags, strict=True)]))

        batched = [x for x, f in zip(leaves, flags, strict=True) if f]
        one = jax.eval_shape(member, [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in batched])
        stacked = jax.lax.map(lambda own: _packed(member(own)), batched)
        return jax.vmap(lambda numbers: _unpacked(numbers, one))(stacked), jax.tree.map(lambda _: True, one)

    return turns


def _packed(answer: Any) -> Packed:
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
