"""The identity of a batch: two processes, or two runs, with the same key compute the same numbers.

The code enters as the program that JAX traces for one member. It covers the change, the outcome and effects of the
user, but no file names, so functions and effects may come from outside pftwin.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.program_cache import settings, versions
from pftwin.base.serialization import fingerprint
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion
from pftwin.dynamics.batch.plan import BatchPlan


def batch_features(plan: BatchPlan, unit: int) -> dict[str, str]:
    """What distinguishes a batch, in words a person can use, each with a hash or a text.

    Args:
        plan: the batch.
        unit: members of a unit.
    """
    from pftwin import __version__

    rows = [jax.tree.map(lambda a: np.asarray(a)[0], g.rows) for g in plan.groups]
    members = [
        fingerprint([np.asarray(a) for a in (*jax.tree.leaves(g.rows), g.places, np.array(g.names))])
        for g in plan.groups
    ]
    chosen = {**plan.settings, "care": plan.care, "piece": plan.spread.piece, "unit": unit}
    return {
        "scenes": fingerprint([_numbers(task) for task in plan.tasks]),
        "program": fingerprint([_program(task, row) for task, row in zip(plan.tasks, rows, strict=True)]),
        "members": fingerprint(members),
        "settings": json.dumps(chosen, sort_keys=True),
        "platform": jax.default_backend(),
        "versions": f"pftwin {__version__}, {versions()}",
    }


def key_of(found: dict[str, str]) -> str:
    """One hash of a batch's features."""
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _is_array(a: Any) -> bool:
    return isinstance(a, jax.Array | np.ndarray | np.generic)


def _numbers(task: Task) -> list[np.ndarray]:
    return [np.asarray(a) for a in jax.tree.leaves(task) if _is_array(a)]


def _program(task: Task, row: Any) -> str:
    first, start = _traced(member_equilibrium, (task, row))
    second, _ = _traced(member_motion, (task, row, start))
    return first + second


def _traced(function: Callable[..., Any], args: Any) -> tuple[str, Any]:
    """A hash of the function's program for such arguments, and its answer's shapes, as arrays of zeros."""
    leaves, structure = jax.tree.flatten(args)
    kinds = tuple(
        jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=getattr(a, "weak_type", False)) if _is_array(a) else None
        for a in leaves
    )
    fixed = tuple(None if _is_array(a) else (type(a), a) for a in leaves)
    return _text(function, structure, kinds, fixed, settings())


@lru_cache(maxsize=64)  # tracing takes seconds, and a batch is often one of many
def _text(
    function: Callable[..., Any],
    structure: Any,
    kinds: tuple[jax.ShapeDtypeStruct | None, ...],
    fixed: tuple[tuple[type, Hashable] | None, ...],
    _: Hashable,
) -> tuple[str, Any]:
    def of(arrays: list[Any]) -> Any:
        rest = iter(arrays)
        leaves = [next(rest) if f is None else f[1] for f in fixed]
        return function(*jax.tree.unflatten(structure, leaves))

    traced = jax.jit(of).trace([k for k in kinds if k is not None])
    text = hashlib.sha256(traced.lower().as_text().encode()).hexdigest()
    return text, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), traced.out_info)
