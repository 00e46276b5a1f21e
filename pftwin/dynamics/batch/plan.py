"""A checked batch, ready to be computed as a whole or in units.

Checks user-defined outcomes before anything is simulated, so that an hour's computing does not end in an error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batch_dataset import COORDINATES, OWN_NAMES
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion
from pftwin.dynamics.batch.retry import Found, all_members, with_care
from pftwin.dynamics.batch.sharding import Sharding
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
    """Refuses outcomes that cannot become variables of the dataset; they are traced, not run.

    Args:
        tasks: of each group of members.
        rows: of each group, tree of (n, ...).

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
