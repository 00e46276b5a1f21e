"""A checked batch, ready to be computed as a whole or in units, and its identity.

Checks user-defined outcomes before anything is simulated, so that an hour's computing does not end in an error. Two
processes, or two runs, whose batches have the same key compute the same numbers. The code enters the key as the program
that JAX traces for one member. It covers the change, the outcome and effects of the user, but no file names, so
functions and effects may come from outside pftwin.
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
from pftwin.base.program_cache import settings, versions
from pftwin.base.serialization import fingerprint
from pftwin.dynamics.batch.batch_dataset import COORDINATES, OWN_NAMES
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion
from pftwin.dynamics.batch.retry import Found, all_members, with_care
from pftwin.dynamics.batch.sharding import Sharding, is_array
from pftwin.dynamics.batch.variants import Group
from pftwin.dynamics.status import Status


class BatchPlan(NamedTuple):
    """What is to be computed, and on what."""

    groups: list[Group]
    tasks: list[Task]  # of each group
    values: Any  # what the change was given, (n, k); None for a list of scenes
    settings: dict[str, Any]  # that the dataset names
    care: tuple[Status, ...]  # flags of members that are computed again
    spread: Sharding
    threads: int

    @property
    def total(self) -> int:
        """Members."""
        return sum(len(g.places) for g in self.groups)

    def found(self, k: int, rows: Any, progress: Callable[[int, int], None] | None = None) -> Found:
        """What comes out of members of group k, by their rows: tree of (n, ...)."""
        task = self.tasks[k]
        found = all_members(self.spread, task, rows, threads=self.threads, progress=progress)
        nothing = np.zeros(len(found["sensible"]), dtype=np.int8)
        return {**found, "recomputed": with_care(self.spread, task, rows, found, self.care) if self.care else nothing}


def some_of(group: Group, which: NDArray[np.int64]) -> Group:
    """The group's members of these numbers."""
    rows = jax.tree.map(lambda a: np.asarray(a)[which], group.rows)
    return group._replace(rows=rows, places=group.places[which], names=[group.names[i] for i in which])


def check_outcomes(tasks: Sequence[Task], rows: Sequence[Any]) -> None:
    """Refuses outcomes of groups of members that cannot become variables of the dataset; they are traced, not run.

    Raises:
        InputError: no dictionary of numbers or arrays; other names or shapes in other groups; a name that the batch has
            itself.
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
    """What distinguishes a batch in units of so many members: words a person can use, each with a hash or a text."""
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
    """One hash of a batch's features."""
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _program(task: Task, row: Any) -> str:
    first, start = _traced(member_equilibrium, (task, row))
    return first + _traced(member_motion, (task, row, start))[0]


def _traced(function: Callable[..., Any], args: Any) -> tuple[str, Any]:
    """A hash of the function's program for such arguments, and its answer's shapes, as arrays of zeros."""
    leaves, structure = jax.tree.flatten(args)
    kinds = tuple(
        jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=getattr(a, "weak_type", False)) if is_array(a) else None
        for a in leaves
    )
    fixed = tuple(None if is_array(a) else (type(a), a) for a in leaves)
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
