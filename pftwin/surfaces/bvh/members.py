"""Searches in a batch: on a CPU one member after the other.

A loop that ends when its own list does is fast alone. Mapped over a batch it turns to the slowest member's end, and
every turn works on all members with masks. One after the other each runs at its own speed; elsewhere than on a CPU, a
batch that is worked on at once wins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.custom_batching import sequential_vmap
from jax.lax import stop_gradient


def member_by_member(search: Callable[..., Any]) -> Callable[..., Any]:
    """A search whose answer is not differentiated, and which in a batch on a CPU runs for one member at a time."""
    if jax.default_backend() == "cpu":
        search = sequential_vmap(search)
    return lambda *args: search(*stop_gradient(args))
