"""The test matrix: each case with each kind of contact, integrator and float type, simulated and differentiated."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.studies.hard_cases import derivatives
from pftwin.studies.hard_cases.batch import (
    BatchRuns,
    CaseBatch,
    Starts,
    batch_faults,
    batches,
    member,
    members,
    other_equilibria,
    short_enough,
    starts_of,
    steps_of,
)
from pftwin.studies.hard_cases.case import INTEGRATORS, CaseIntegrator, HardCase, limit_of
from pftwin.studies.hard_cases.contacts import CONTACTS, PATCHES
from pftwin.studies.hard_cases.derivatives import Reference
from pftwin.studies.hard_cases.knee import RATE
from pftwin.studies.hard_cases.programs import CaseRun, compiled, depths, poses, slopes
from pftwin.studies.hard_cases.verdict import Cell, Evidence, Truth, restitution_remarked, truths, verdict

DTYPES = ("float64", "float32")
MOST_LOOKS = 200  # approximate number of frames of a run at which the depth is searched
Say = Callable[[str], None]
Count = Callable[[int], None]  # receives the number of cells that were judged or omitted since the last call
Forward = Callable[[Any, list[int]], CaseRun]  # runs some cases with changed parameters


class Selection(NamedTuple):
    """The part of the matrix to run."""

    contacts: tuple[str, ...] = CONTACTS
    integrators: tuple[CaseIntegrator, ...] = INTEGRATORS
    dtypes: tuple[str, ...] = DTYPES
    derivatives: bool = True
    batch_independence: bool = True
    truths: bool = True

    def able(self, contact: str) -> tuple[CaseIntegrator, ...]:
        """The integrators that run with a kind of contact."""
        return tuple(m for m in self.integrators if m.only is None or contact in m.only)

    def dtypes_of(self, method: CaseIntegrator) -> list[str]:
        """The float types that an integrator runs in, float64 first."""
        return sorted((d for d in self.dtypes if d == "float64" or method.float32), key=DTYPES.index)

    def cells_of(self, cases: Sequence[HardCase]) -> int:
        """The number of cells, with those that are omitted because they would take too many steps."""
        return sum(
            len(self.dtypes_of(method)) * sum(contact in case.contacts for case in cases)
            for contact in self.contacts
            for method in self.able(contact)
        )


EVERYTHING = Selection()


def run_matrix(
    cases: Sequence[HardCase],
    selection: Selection = EVERYTHING,
    say: Say = lambda _: None,
    count: Count = lambda _: None,
) -> list[Cell]:
    """Runs and judges cases; returns a cell for each combination of case, contact, integrator and float type.

    `say` receives progress messages, `count` the number of cells done since its last call; their sum
    is that of `Selection.cells_of`.
    """
    cells: list[Cell] = []
    for contact in selection.contacts:
        prepared = Prepared(cases, contact, selection)
        for method in selection.able(contact):
            cells += cells_of(prepared, method, say, count)
    return cells


class Prepared:
    """The cases with one kind of contact; scenes, starts and converged runs are computed on first use."""

    def __init__(self, cases: Sequence[HardCase], contact: str, selection: Selection) -> None:
        """Computes nothing yet."""
        self.cases, self.contact, self.selection = cases, contact, selection
        self._built: dict[str, tuple[list[CaseBatch], dict[str, InputError]]] = {}
        self._stacks: dict[str, list[tuple[CaseBatch, Starts]]] = {}

    def batches(self, dtype: str) -> tuple[list[CaseBatch], dict[str, InputError]]:
        """Returns the batches, and the errors of rejected scenes by case."""
        if dtype not in self._built:
            with jax.enable_x64(dtype == "float64"):
                self._built[dtype] = batches(self.cases, self.contact)
        return self._built[dtype]

    def stacks(self, dtype: str) -> list[tuple[CaseBatch, Starts]]:
        """Returns the batches with their starting states."""
        if dtype not in self._stacks:
            with jax.enable_x64(dtype == "float64"):
                self._stacks[dtype] = [(batch, starts_of(batch, dtype)) for batch in self.batches(dtype)[0]]
        return self._stacks[dtype]

    @cached_property
    def elsewhere(self) -> list[tuple[CaseBatch, Starts]]:
        """Cases that start in another equilibrium in float32, as float64 batches that start there."""
        found = []
        single = {c.name: member(s.chosen, k) for b, s in self.stacks("float32") for k, c in enumerate(b.cases)}
        with jax.enable_x64(True):
            for batch, starts in self.stacks("float64"):
                both = [k for k, c in enumerate(batch.cases) if c.name in single]
                if not both:
                    continue
                own = batch.only(both)
                theirs = jax.tree.map(lambda *a: np.stack(a), *(single[c.name] for c in own.cases))
                which, near = other_equilibria(own, members(starts.chosen, both), theirs)
                if which:
                    found.append((own.only(which), Starts(near, {})))
        return found

    @cached_property
    def _truths(self) -> dict[str, Truth]:
        return self._converged(self.stacks("float64"))

    @cached_property
    def _truths_elsewhere(self) -> dict[str, Truth]:
        return self._converged(self.elsewhere)

    def truths(self, dtype: str) -> dict[str, Truth]:
        """Converged runs by case, always in float64, from where runs in `dtype` start; empty if not selected."""
        if not self.selection.truths:
            return {}
        return self._truths if dtype == "float64" else self._truths | self._truths_elsewhere

    def _converged(self, stacks: list[tuple[CaseBatch, Starts]]) -> dict[str, Truth]:
        with jax.enable_x64(True):
            found = [truths(batch, starts.chosen, self.contact) for batch, starts in stacks]
        return {name: truth for part in found for name, truth in part.items()}


def cells_of(
    prepared: Prepared, method: CaseIntegrator, say: Say = lambda _: None, count: Count = lambda _: None
) -> list[Cell]:
    """Runs all cases with one kind of contact and one integrator, in the selected float types."""
    cells: list[Cell] = []
    references: dict[str, Reference] = {}
    for dtype in prepared.selection.dtypes_of(method):
        with jax.enable_x64(dtype == "float64"):
            cells += _of_float_type(prepared, method, dtype, references, say, count)
    return cells


def _of_float_type(
    prepared: Prepared, method: CaseIntegrator, dtype: str, references: dict[str, Reference], say: Say, count: Count
) -> list[Cell]:
    """Runs all cases in one float type; stores finite differences in `references` for the other."""
    contact, (made, refused) = prepared.contact, prepared.batches(dtype)
    said = {c.name: _refusal(c, refused[c.name]) for c in prepared.cases if c.name in refused}
    unfit = limit_of(contact).without_inertia is not None and not method.inertia
    if unfit:
        said |= {c.name: _without_inertia(batch, contact, method) for batch in made for c in batch.cases}
    cells = [Cell(name, contact, method.name, dtype, *outcome) for name, outcome in said.items()]
    count(len(cells))
    for batch, starts in [] if unfit else prepared.stacks(dtype):
        began = time.perf_counter()
        which = short_enough(batch, method)
        count(len(batch.cases) - len(which))
        if not which:
            continue
        own = batch.only(which)
        chosen = starts._replace(chosen=members(starts.chosen, which))
        cells += _run_batch(prepared, own, chosen, method, dtype, references)
        count(len(which))
        say(f"{contact}, {method.name}, {dtype}: {len(which)} cases in {time.perf_counter() - began:.1f} s")
    return cells


def _refusal(case: HardCase, error: InputError) -> tuple[str, str]:
    """Outcome and reason of a case whose scene was rejected."""
    words = case.expected.refusal
    if words is not None and words in str(error):
        return "refused", str(error)
    return "fail", f"{'refused' if words is None else 'refused for another reason'}: {error}"


def _without_inertia(batch: CaseBatch, contact: str, method: CaseIntegrator) -> tuple[str, str]:
    """Outcome and reason of an integrator that must reject this contact."""
    try:
        method.integrator.refuse_unfit(batch.scenes.effects)
    except InputError as error:
        return "refused" if (limit_of(contact).without_inertia or "") in str(error) else "fail", str(error)
    return "fail", "not refused"


def _run_batch(
    prepared: Prepared, batch: CaseBatch, starts: Starts, method: CaseIntegrator, dtype: str,
    references: dict[str, Reference],
) -> list[Cell]:  # fmt: skip
    contact, selection, double = prepared.contact, prepared.selection, dtype == "float64"
    n, chosen = len(batch.cases), method.integrator
    tried = BatchRuns(batch, starts.chosen, chosen, double)
    choices = tried.chosen([steps_of(c, method) for c in batch.cases], method)
    substeps = [choice.substeps for choice in choices]
    runs = [choice.run for choice in choices]
    depth = _depths(batch, runs, double)
    columns = None
    if selection.derivatives and (method.differentiated_on is None or contact in method.differentiated_on):
        columns = compiled(slopes, double, integrator=chosen)(batch.scenes, starts.chosen, jnp.asarray(substeps))
        if double:
            references |= _references(batch, columns, runs, partial(tried.with_parameters, substeps))
        elif references:
            for others, begun in prepared.elsewhere:
                references |= _references_from(others, begun, method)
    dependent: dict[str, str] = {}
    if selection.batch_independence and n > 1 and contact in PATCHES:  # batched mesh searches compile for minutes
        dependent = batch_faults(batch, starts.chosen, jnp.asarray(substeps), method, dtype)
    by_name = {c.name: runs[k] for k, c in enumerate(batch.cases)}
    cells = []
    for k, case in enumerate(batch.cases):
        step = 1 / RATE / substeps[k]
        evidence = Evidence(
            by_name,
            None if columns is None else columns[k],
            references.get(case.name),
            starts.wrong.get(case.name),
            dependent.get(case.name),
            depth[k],
            step,
            prepared.truths(dtype).get(case.name) if method.inertia else None,
            partial(restitution_remarked, member(batch.scenes, k), runs[k], chosen, step),
        )
        cells.append(verdict(case, contact, method, dtype, evidence))
    return cells


def _depths(batch: CaseBatch, runs: Sequence[CaseRun], float64: bool) -> NDArray[np.float64]:
    """Penetration depths by exhaustive search, (cases, frames) [m]; NaN at skipped frames of long motions."""
    frames = runs[0].observation.status.size
    sampled = np.arange(0, frames, max(1, frames // MOST_LOOKS))
    centers = jax.tree.map(lambda *a: np.stack(a)[:, sampled], *(r.observation.center for r in runs))
    depth = np.full((len(batch.cases), frames), np.nan)
    depth[:, sampled] = np.asarray(compiled(depths, float64)(batch.scenes, centers))
    return depth


def _references_from(batch: CaseBatch, starts: Starts, method: CaseIntegrator) -> dict[str, Reference]:
    """References of smooth cases by name, from these starts in float64."""
    with jax.enable_x64(True):
        which = short_enough(batch, method)
        own = batch.only(which)
        begun = members(starts.chosen, which)
        tried = BatchRuns(own, begun, method.integrator, True)
        choices = tried.chosen([steps_of(c, method) for c in own.cases], method)
        substeps = [choice.substeps for choice in choices]
        columns = compiled(slopes, True, integrator=method.integrator)(own.scenes, begun, jnp.asarray(substeps))
        forward = partial(tried.with_parameters, substeps)
        return _references(own, columns, [choice.run for choice in choices], forward)


def _references(
    batch: CaseBatch, slopes: NDArray[Any], runs: Sequence[CaseRun], forward: Forward
) -> dict[str, Reference]:
    """References of smooth cases by name; finite differences are refined where they differ from the derivatives."""
    smooth = [k for k, c in enumerate(batch.cases) if c.expected.smooth]
    if not smooth:
        return {}

    def differences(which: list[int], share: float = 1.0) -> dict[int, NDArray[np.float64]]:
        by_case = derivatives.differences(lambda p: poses(forward(p, which).states), share)
        return dict(zip(which, by_case, strict=True))

    found = differences(smooth)
    off = [k for k in smooth if derivatives.disagree(slopes[k], found[k], "float64")]
    finer = differences(off, derivatives.FINER) if off else {}
    found |= {k: derivatives.agreeing_differences(found[k], fine) for k, fine in finer.items()}
    return {batch.cases[k].name: Reference(d, np.asarray(poses(runs[k].states))) for k, d in found.items()}
