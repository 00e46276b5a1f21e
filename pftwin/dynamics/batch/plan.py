"""A validated batch, ready to be computed as a whole or in units, and the key that identifies it.

User-defined outcomes are checked before any simulation, so that an hour of computing does not end in an error. Two
processes or runs whose batches have the same key compute the same numbers. The key depends on the code through the
program that JAX traces for one variant. That covers the user's change, outcome and effects, which may come from outside
pftwin, but no file names.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Hashable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.leaves import Fixed, split_arguments
from pftwin.base.program_cache import settings, versions
from pftwin.base.serialization import fingerprint
from pftwin.dynamics.batch.batch_dataset import COORDINATES, OWN_NAMES
from pftwin.dynamics.batch.batched import Sharding, is_array
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion
from pftwin.dynamics.batch.retry import Found, all_members, with_care
from pftwin.dynamics.batch.variants import Group
from pftwin.dynamics.status import Status


class BatchPlan(NamedTuple):
    """The variants to compute, and the devices and threads to use."""

    groups: list[Group]
    tasks: list[Task]  # one per group
    values: Any  # rows of `Variants.values`, (n, k); None for a list of scenes
    settings: dict[str, Any]  # attributes of the dataset
    care: tuple[Status, ...]  # flags of variants to recompute
    spread: Sharding
    threads: int

    @property
    def total(self) -> int:
        """Number of variants."""
        return sum(len(g.places) for g in self.groups)

    def found(self, k: int, rows: Any, progress: Callable[[int, int], None] | None = None) -> Found:
        """Computes variants of group k from their rows; returns a pytree of arrays (n, ...)."""
        task = self.tasks[k]
        found = all_members(self.spread, task, rows, threads=self.threads, progress=progress)
        nothing = np.zeros(len(found["sensible"]), dtype=np.int8)
        return {**found, "recomputed": with_care(self.spread, task, rows, found, self.care) if self.care else nothing}


def some_of(group: Group, which: NDArray[np.int64]) -> Group:
    """The group with only the variants of the indices `which`."""
    rows = jax.tree.map(lambda a: np.asarray(a)[which], group.rows)
    return group._replace(rows=rows, places=group.places[which], names=[group.names[i] for i in which])


def check_outcomes(tasks: Sequence[Task], rows: Sequence[Any]) -> None:
    """Checks, by tracing, that user-defined outcomes can become variables of the dataset.

    Raises:
        InputError: an outcome is not a dictionary of numbers or arrays, names or shapes differ between groups, or a
            name is one of the batch's own.
    """
    if not tasks or tasks[0].outcome is None:
        return
    found = [_shapes(task, jax.tree.map(lambda a: a[0], some)) for task, some in zip(tasks, rows, strict=True)]
    if any(other != found[0] for other in found):
        raise InputError("found other outcomes in other scenes", where="outcome", expected="the same names and shapes")
    if taken := sorted(OWN_NAMES.union(COORDINATES) & set(found[0])):
        raise InputError(f"found {taken[0]!r}", where="outcome", expected="names that the batch does not have itself")


def _shapes(task: Task, row: Any) -> dict[str, tuple[int, ...]]:
    def own(task: Task, row: Any) -> Any:
        return member_motion(task, row, member_equilibrium(task, row))["own"]

    made = eqx.filter_eval_shape(own, task, row)
    if stray := [n for n, a in made.items() if not (isinstance(n, str) and isinstance(a, jax.ShapeDtypeStruct))]:
        raise InputError(f"found {stray[0]!r}", where="outcome", expected="names with numbers or arrays")
    return {name: a.shape for name, a in made.items()}


def batch_features(plan: BatchPlan, unit: int) -> dict[str, str]:
    """Features that identify a batch in units of `unit` variants: readable names, each with a hash or a text."""
    from pftwin import __version__

    rows = [jax.tree.map(lambda a: np.asarray(a)[0], g.rows) for g in plan.groups]
    members = [
        fingerprint([np.asarray(a) for a in (*jax.tree.leaves(g.rows), g.places, np.array(g.names))])
        for g in plan.groups
    ]
    chosen = {**plan.settings, "care": plan.care, "piece": plan.spread.piece, "unit": unit}
    return {
        "scenes": fingerprint([[np.asarray(a) for a in jax.tree.leaves(t) if is_array(a)] for t in plan.tasks]),
        "program": fingerprint([_program(task, row) for task, row in zip(plan.tasks, rows, strict=True)]),
        "members": fingerprint(members),
        "settings": json.dumps(chosen, sort_keys=True),
        "platform": jax.default_backend(),
        "versions": f"pftwin {__version__}, {versions()}",
    }


def key_of(found: dict[str, str]) -> str:
    """Hash of the features of a batch."""
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _program(task: Task, row: Any) -> str:
    first, start = _traced(member_equilibrium, (task, row))
    return first + _traced(member_motion, (task, row, start))[0]


def _traced(function: Callable[..., Any], args: Any) -> tuple[str, Any]:
    """Hash of the function's program for arguments of this kind, and zeros of the shapes of its result."""
    fixed, arrays = split_arguments(args, is_array)
    kinds = [jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=getattr(a, "weak_type", False)) for a in arrays]
    return _text(function, fixed, tuple(kinds), settings())


@lru_cache(maxsize=64)  # tracing takes seconds, and similar batches often follow
def _text(
    function: Callable[..., Any], fixed: Fixed, kinds: tuple[jax.ShapeDtypeStruct, ...], _: Hashable
) -> tuple[str, Any]:
    def of(arrays: list[Any]) -> Any:
        return function(*fixed.with_arrays(arrays))

    traced = jax.jit(of).trace(list(kinds))
    text = hashlib.sha256(traced.lower().as_text().encode()).hexdigest()
    return text, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), traced.out_info)
