"""Recomputation of variants whose run is unreliable, with other methods; the other variants do not change."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batched import Chunk, Sharding
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion, settled_after_relaxing
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


def all_members(
    spread: Sharding, task: Task, rows: Any, relaxed: bool = False, threads: int = 1, progress: Any = None
) -> Found:
    """Computes equilibria and motions of all rows; returns a pytree of arrays (n, ...) on the host.

    With `relaxed`, damped relaxation precedes the search for equilibrium; `threads`, `progress`: see `Sharding.over`.
    """
    shared = spread.shared(task)

    def work(chunk: Chunk) -> Found:
        own = spread.placed(rows, chunk)
        start = spread.run(settled_after_relaxing if relaxed else member_equilibrium, shared, chunk, (own,))
        return spread.taken(spread.run(member_motion, shared, chunk, (own, start)), chunk)

    return spread.over(work, len(jax.tree.leaves(rows)[0]), threads, progress)


def with_care(
    spread: Sharding, task: Task, rows: Any, found: Found, bad_ones: tuple[Status, ...] = BAD
) -> NDArray[np.int8]:
    """Recomputes variants with bad flags, in place: from a relaxed start, with smaller steps, or another integrator.

    Returns:
        The method used, (n,), an index into `WAYS`. A variant for which no method helps keeps its first result.
    """
    done = np.zeros(len(found["sensible"]), dtype=np.int8)
    relaxed = np.zeros(done.size, dtype=bool)
    lost = _flagged(found, (Status.START_NOT_IN_EQUILIBRIUM,)) & found["sensible"]
    if lost.any():
        better = all_members(spread, task, _selected_rows(rows, lost), relaxed=True)
        relaxed = _taken_over(found, better, lost, ~_flagged(better, (Status.START_NOT_IN_EQUILIBRIUM,)))
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
                better = all_members(spread, with_more, _selected_rows(rows, group), relaxed=from_relaxed)
                done[_taken_over(found, better, group, ~_flagged(better, bad_ones))] = way
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


def _selected_rows(rows: Any, which: NDArray[np.bool_]) -> Any:
    return jax.tree.map(lambda a: np.asarray(a)[which], rows)


def _taken_over(found: Found, better: Found, which: NDArray[np.bool_], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Copies those recomputed variants that are good into `found`; returns which these are, (n,)."""
    places = np.flatnonzero(which)[good]

    def put(old: NDArray[Any], new: NDArray[Any]) -> None:
        old[places] = new[good]

    jax.tree.map(put, found, better)
    taken = np.zeros(which.size, dtype=bool)
    taken[places] = True
    return taken
