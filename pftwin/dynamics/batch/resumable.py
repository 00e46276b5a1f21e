"""Resumable computation of a batch in units, each written when it is done, by one or several processes.

Units depend on the batch alone, so that any number of processes can fill one folder, successively or concurrently.
Processes first agree on what is missing, divide it among themselves, and synchronise when each has finished its share.
The unfinished share of a lost process is divided among the others.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from pftwin.base.errors import InputError, OutputError, PftwinError, PftwinWarning
from pftwin.dynamics.batch.batch_dataset import dataset
from pftwin.dynamics.batch.devices import Processes
from pftwin.dynamics.batch.parts import (
    SHOWN,
    BatchIndex,
    check_shared_folder,
    concatenated_parts,
    part_file,
    prepare_folder,
    read_part,
    write_part,
)
from pftwin.dynamics.batch.plan import BatchPlan, batch_features, key_of, subset

if TYPE_CHECKING:
    from xarray import Dataset

Share = tuple[int, int]  # (k, n): the k-th of n shares, k from 0
Tell = Callable[[int, int], None]


class ResumableBatch:
    """One call's computation of a batch in a folder, in units of `unit` variants.

    Without a share it computes what is missing, with all processes. `tell` is called with the number of variants that
    this process has computed, and the number that it has to compute.
    """

    def __init__(self, plan: BatchPlan, folder: Path, unit: int, share: Share | None, tell: Tell | None) -> None:
        self.plan, self.folder, self.share, self.tell = plan, folder, share, tell
        numbers = [np.arange(len(g.places)) for g in plan.groups]
        # Group of each unit, and its variants as indices within the group.
        self.units = [(k, n[i : i + unit]) for k, n in enumerate(numbers) for i in range(0, len(n), unit)]
        found = batch_features(plan, unit)
        self.index = BatchIndex(key_of(found), found, [len(which) for _, which in self.units])
        self.processes = Processes()
        self.done: dict[int, Dataset] = {}
        self.own, self.counted = 0, 0  # number of variants to compute, and computed

    def all(self) -> Dataset:
        """Computes the missing units, and reads those that exist or that other processes write.

        Raises:
            InputError: processes have different batches, or the folder contains another batch.
            OutputError: a part cannot be written.
            PftwinError: another process failed; the message contains its error.
        """
        self._check_same_batch()
        if self.share is not None and self.share[0] >= len(self.units):
            raise InputError(
                f"share {self.share[0]} of {len(self.units)} parts, counted from 0",
                where="share",
                expected=f"a number below {len(self.units)}: the others have nothing left to do",
            )
        asked = [u for u in range(len(self.units)) if self.share is None or u % self.share[1] == self.share[0]]
        missing = self._missing(asked)
        if missing and self.processes.count > 1:
            self._on_all_processes(lambda: check_shared_folder(self.folder, self.index, SHOWN))
        while missing:
            shares = {p: missing[i :: len(self.processes.alive)] for i, p in enumerate(self.processes.alive)}
            self._on_all_processes(lambda own=shares[self.processes.index]: self._compute(own))
            lost = [p for p in shares if p not in self.processes.alive]
            missing = self._missing([u for p in lost for u in shares[p]]) if lost else []
            if lost:
                names = " and ".join(map(str, lost))
                text = f"process {names} was lost; the others compute the {len(missing)} parts it left undone"
                warnings.warn(text, PftwinWarning, stacklevel=2)
        for unit in asked:
            if unit not in self.done:
                self.done[unit] = read_part(self.folder, unit, self.index, SHOWN)
        return concatenated_parts([self.done[u] for u in asked])

    def _check_same_batch(self) -> None:
        """Checks that all processes have the same batch."""
        said = self.processes.gathered(json.dumps(self.index.features))
        first = json.loads(said[min(said)])
        for process, text in said.items():
            other = json.loads(text)
            if unlike := [name for name in first if other.get(name) != first[name]]:
                raise InputError(
                    f"process {process} has another batch than process {min(said)}, with other {' and '.join(unlike)}",
                    where="simulate_batch",
                    expected="the same call in all processes",
                    remedy="random numbers from a fixed seed, the same files and the same versions everywhere",
                )

    def _missing(self, asked: Sequence[int]) -> list[int]:
        """Units without a valid part according to the first process, so that all processes use the same list."""

        def missing() -> list[int]:
            prepare_folder(self.folder, self.index)
            return [u for u in asked if not self._is_valid(u)]

        first = min(self.processes.alive) == self.processes.index
        return self._on_all_processes(missing if first else list)[min(self.processes.alive)]

    def _is_valid(self, unit: int) -> bool:
        path = part_file(self.folder, unit)
        if not path.exists():
            return False
        try:
            self.done[unit] = read_part(self.folder, unit, self.index)
        except InputError as error:
            warnings.warn(f"{error}; it is computed anew now", PftwinWarning, stacklevel=2)
            return False
        return True

    def _on_all_processes(self, work: Callable[[], Any]) -> dict[int, Any]:
        """The result of `work` by process. If one fails, all raise an error, so that none waits forever.

        Raises:
            Exception: this process failed.
            PftwinError: another process failed; an InputError or OutputError if its error was one.
        """
        failure, said = None, {}
        try:
            said = {"answer": work()}
        except Exception as error:
            failure, said = error, {"failed": str(error) or repr(error), "kind": type(error).__name__}
        answers = {p: json.loads(text) for p, text in self.processes.gathered(json.dumps(said)).items()}
        if failure is not None:
            raise failure
        for process, answer in answers.items():
            if "failed" in answer:
                text = f"process {process}: {answer['failed']}"
                raise {"InputError": InputError, "OutputError": OutputError}.get(answer["kind"], PftwinError)(text)
        return {p: answer["answer"] for p, answer in answers.items()}

    def _compute(self, units: list[int]) -> None:
        """Computes and writes units, as many of one group together as keep all devices busy."""
        self.own += sum(self.index.units[u] for u in units)
        for k in range(len(self.plan.groups)):
            waiting = [u for u in units if self.units[u][0] == k]
            while waiting:
                at_once = max(1, self.plan.sharding.most * self.plan.threads // self.index.units[waiting[0]])
                self._compute_units(k, waiting[:at_once])
                waiting = waiting[at_once:]

    def _compute_units(self, k: int, units: list[int]) -> None:
        plan, tell = self.plan, self.tell
        each = [subset(plan.groups[k], self.units[u][1]) for u in units]
        rows = jax.tree.map(lambda *a: np.concatenate(a), *[g.rows for g in each])
        progress = None if tell is None else (lambda done, _: tell(self.counted + done, self.own))
        found = plan.found(k, rows, progress)
        last = 0
        for unit, group in zip(units, each, strict=True):
            first, last = last, last + len(group.places)
            part = jax.tree.map(lambda a, i=first, j=last: a[i:j], found)
            members = dataset([group], [part], plan.values, plan.settings)
            write_part(self.folder, unit, self.index.key, members)
            self.done[unit] = members
        self.counted += last
