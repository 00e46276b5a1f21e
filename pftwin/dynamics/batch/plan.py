"""A checked batch, ready to be computed as a whole or in units."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from pftwin.dynamics.batch.member import Task
from pftwin.dynamics.batch.retry import Found, all_members, with_care
from pftwin.dynamics.batch.sharding import Sharding
from pftwin.dynamics.batch.variants import Group


class BatchPlan(NamedTuple):
    """What is to be computed, and on what."""

    groups: list[Group]
    tasks: list[Task]  # of each group
    values: Any  # what the change was given, (n, k); None for a list of scenes
    settings: dict[str, Any]  # that the dataset names
    care: bool
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
        return {**found, "recomputed": with_care(self.spread, task, rows, found) if self.care else nothing}


def some_of(group: Group, which: NDArray[np.int64]) -> Group:
    """The group's members of these numbers."""
    rows = jax.tree.map(lambda a: np.asarray(a)[which], group.rows)
    return group._replace(rows=rows, places=group.places[which], names=[group.names[i] for i in which])
