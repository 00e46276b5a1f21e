"""Checks user-defined outcomes before anything is simulated, so that an hour's computing does not end in an error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batch_dataset import COORDINATES, OWN_NAMES
from pftwin.dynamics.batch.member import Task, moved, settled


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
        return moved(task, row, settled(task, row))["own"]

    made = eqx.filter_eval_shape(own, task, row)
    if stray := [n for n, a in made.items() if not (isinstance(n, str) and isinstance(a, jax.ShapeDtypeStruct))]:
        raise InputError(f"found {stray[0]!r}", where="outcome", expected="names with numbers or arrays")
    return {name: a.shape for name, a in made.items()}
