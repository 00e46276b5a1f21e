"""Timing compiled functions with compilation told apart."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

_compiled_before: set[Any] = set()


def timed(function: Callable[..., Any], *args: Any) -> tuple[Any, float, float]:
    """The answer, the seconds of a run, and the seconds spent compiling.

    The first call for arguments of a kind compiles: it is then run once more, so that the run's own time is known.
    """
    kind = (function, _kind(args))
    began = time.perf_counter()
    answer = jax.block_until_ready(function(*args))
    elapsed = time.perf_counter() - began
    if kind in _compiled_before:
        return answer, elapsed, 0.0
    _compiled_before.add(kind)
    began = time.perf_counter()
    answer = jax.block_until_ready(function(*args))
    run = time.perf_counter() - began
    return answer, run, max(elapsed - run, 0.0)


def _kind(args: Any) -> Any:
    """What decides whether a compiled program fits: structure, shapes and types of arrays, and all that is no array."""
    arrays, static = eqx.partition(args, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    fixed, fixed_structure = jax.tree.flatten(static)
    return structure, tuple((a.shape, str(a.dtype)) for a in leaves), fixed_structure, tuple(fixed)
