"""A validated batch, its computation as a whole or in units, and the key that identifies it.

Variants whose run is unreliable are recomputed with other methods; the other variants do not change.

Two processes or runs whose batches have the same key compute the same numbers. The key depends on the code through the
program that JAX traces for one variant. That covers the user's change, outcome and effects, which may come from outside
pftwin, but no file names.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.leaves import Fixed, split_arguments
from pftwin.base.program_cache import settings, versions
from pftwin.base.serialization import fingerprint
from pftwin.dynamics.batch.batched import Chunk, Sharding, is_array
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion, settled_after_relaxing
from pftwin.dynamics.batch.variants import Group
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit, Newmark
from pftwin.dynamics.status import FLAGS, Status

# Flags of an unreliable run. A patella that leaves its patch or its groove is physics, not an error.
BAD = (Status.STEP_TOO_LONG, Status.NOT_FINITE, Status.ENERGY_FROM_NOWHERE, Status.START_NOT_IN_EQUILIBRIUM)
BAD_BY_DEFAULT = (*BAD, Status.INACCURATE)  # if the user gave neither step nor tolerance
WAYS = ("no", "relaxed_start", "smaller_step", "other_integrator", "in_vain")  # `recomputed` is an index into these
SMALLER = 4  # factor on the number of steps
_OTHERS: tuple[Integrator, ...] = (Newmark(), LinearImplicit())
Found = dict[str, Any]


class BatchPlan(NamedTuple):
    """The variants to compute, and the devices and threads to use."""

    groups: list[Group]
    tasks: list[Task]  # one per group
    values: Any  # rows of `Variants.values`, (n, k); None for a list of scenes
    settings: dict[str, Any]  # attributes of the dataset
    care: tuple[Status, ...]  # flags of variants to recompute
    sharding: Sharding
    threads: int

    @property
    def total(self) -> int:
        """Number of variants."""
        return sum(len(g.places) for g in self.groups)

    def found(self, k: int, rows: Any, progress: Callable[[int, int], None] | None = None) -> Found:
        """Computes variants of group k from their rows; returns a pytree of arrays (n, ...)."""
        task = self.tasks[k]
        found = all_members(self.sharding, task, rows, threads=self.threads, progress=progress)
        if not self.care:
            return {**found, "recomputed": np.zeros(len(found["sensible"]), dtype=np.int8)}
        return {**found, "recomputed": recompute_flagged(self.sharding, task, rows, found, self.care)}


def subset(group: Group, which: NDArray[np.int64]) -> Group:
    """The group with only the variants of the indices `which`."""
    return group._replace(
        rows=_selected_rows(group.rows, which), places=group.places[which], names=[group.names[i] for i in which]
    )


def batch_features(plan: BatchPlan, unit: int) -> dict[str, str]:
    """Features that identify a batch in units of `unit` variants: readable names, each with a hash or a text."""
    from pftwin import __version__

    rows = [jax.tree.map(lambda a: np.asarray(a)[0], g.rows) for g in plan.groups]
    members = [
        fingerprint([np.asarray(a) for a in (*jax.tree.leaves(g.rows), g.places, np.array(g.names))])
        for g in plan.groups
    ]
    chosen = {**plan.settings, "care": plan.care, "piece": plan.sharding.piece, "unit": unit}
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


def all_members(
    sharding: Sharding, task: Task, rows: Any, relaxed: bool = False, threads: int = 1, progress: Any = None
) -> Found:
    """Computes equilibria and motions of all rows; returns a pytree of arrays (n, ...) on the host.

    With `relaxed`, damped relaxation precedes the search for equilibrium; `threads`, `progress`: see `Sharding.over`.
    """
    shared = sharding.shared(task)

    def work(chunk: Chunk) -> Found:
        own = sharding.placed(rows, chunk)
        start = sharding.run(settled_after_relaxing if relaxed else member_equilibrium, shared, chunk, (own,))
        return sharding.taken(sharding.run(member_motion, shared, chunk, (own, start)), chunk)

    return sharding.over(work, len(jax.tree.leaves(rows)[0]), threads, progress)


def recompute_flagged(
    sharding: Sharding, task: Task, rows: Any, found: Found, bad_ones: tuple[Status, ...] = BAD
) -> NDArray[np.int8]:
    """Recomputes variants with bad flags, in place: from a relaxed start, with smaller steps, or another integrator.

    Returns:
        The method used, (n,), an index into `WAYS`. A variant for which no method helps keeps its first result.
    """
    done = np.zeros(len(found["sensible"]), dtype=np.int8)
    relaxed = np.zeros(done.size, dtype=bool)
    lost = _flagged(found, (Status.START_NOT_IN_EQUILIBRIUM,)) & found["sensible"]
    if lost.any():
        better = all_members(sharding, task, _selected_rows(rows, lost), relaxed=True)
        relaxed = _adopt_good(found, better, lost, ~_flagged(better, (Status.START_NOT_IN_EQUILIBRIUM,)))
        done[lost] = WAYS.index("in_vain")
        done[relaxed] = WAYS.index("relaxed_start")
    careful = task._replace(substeps=jnp.asarray(np.asarray(task.substeps) * SMALLER))
    ways = [(WAYS.index("smaller_step"), careful)]
    if other := _fallback_integrator(task):
        ways.append((WAYS.index("other_integrator"), careful._replace(integrator=other)))
    for way, with_more in ways:
        bad = _flagged(found, bad_ones) & found["sensible"] & (done != WAYS.index("in_vain"))
        for group, from_relaxed in ((bad & ~relaxed, False), (bad & relaxed, True)):
            if group.any():
                better = all_members(sharding, with_more, _selected_rows(rows, group), relaxed=from_relaxed)
                done[_adopt_good(found, better, group, ~_flagged(better, bad_ones))] = way
    still = _flagged(found, bad_ones) & found["sensible"]
    done[still] = WAYS.index("in_vain")
    return done


def _fallback_integrator(task: Task) -> Integrator | None:
    """Another kind of integrator that supports the task's effects; None if there is none."""
    if not task.integrator.inertia:
        return None
    for other in _OTHERS:
        if other.name != task.integrator.name:
            try:
                other.refuse_unfit(task.scene.effects)
            except InputError:  # it does not support an effect of this scene
                continue
            return other
    return None


def _flagged(found: Found, flags: tuple[Status, ...]) -> NDArray[np.bool_]:
    return (found["status_frames"][:, [FLAGS.index(f) for f in flags]] > 0).any(axis=1)


def _selected_rows(rows: Any, which: NDArray[Any]) -> Any:
    return jax.tree.map(lambda a: np.asarray(a)[which], rows)


def _adopt_good(found: Found, better: Found, which: NDArray[np.bool_], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Copies those recomputed variants that are good into `found`; returns which these are, (n,)."""
    places = np.flatnonzero(which)[good]

    def put(old: NDArray[Any], new: NDArray[Any]) -> None:
        old[places] = new[good]

    jax.tree.map(put, found, better)
    taken = np.zeros(which.size, dtype=bool)
    taken[places] = True
    return taken
