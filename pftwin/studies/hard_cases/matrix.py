"""The matrix: every case with every kind of contact, integrator and float type, forward and differentiated."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.dynamics.integrators import integrator_from_text
from pftwin.studies.hard_cases import derivatives
from pftwin.studies.hard_cases.batch import (
    CaseBatch,
    Starts,
    batch_mates,
    batches,
    member,
    selected_cases,
    short_enough,
    starts_of,
    starts_part,
    steps_of,
)
from pftwin.studies.hard_cases.case import INTEGRATORS, CaseIntegrator, HardCase, limit_of
from pftwin.studies.hard_cases.contacts import CONTACTS, PATCHES
from pftwin.studies.hard_cases.knee import RATE
from pftwin.studies.hard_cases.programs import PARAMETERS, CaseRun, compiled, depths, poses, run, slopes
from pftwin.studies.hard_cases.verdict import Cell, Evidence, verdict

DTYPES = ("float64", "float32")
MOST_LOOKS = 200  # frames of a run for which the depth is searched
Say = Callable[[str], None]


class Selection(NamedTuple):
    """The part of the matrix to run."""

    contacts: tuple[str, ...] = CONTACTS
    integrators: tuple[CaseIntegrator, ...] = INTEGRATORS
    dtypes: tuple[str, ...] = DTYPES
    derivatives: bool = True
    mates: bool = True


EVERYTHING = Selection()


def run_matrix(cases: Sequence[HardCase], selection: Selection = EVERYTHING, say: Say = lambda _: None) -> list[Cell]:
    """Runs cases and judges them.

    Args:
        cases: from `pftwin.studies.hard_cases.catalogue`.
        selection: contacts, integrators, float types; whether to check derivatives and batches.
        say: called with the current step.

    Returns:
        A cell for each case, contact, integrator and float type for which there is such a scene.
    """
    cells: list[Cell] = []
    for contact in selection.contacts:
        references: dict[tuple[str, str], NDArray[np.float64]] = {}
        for dtype in sorted(selection.dtypes, key=DTYPES.index):
            with jax.enable_x64(dtype == "float64"):
                cells += _of_contact(cases, contact, dtype, selection, references, say)
    return cells


def _of_contact(
    cases: Sequence[HardCase],
    contact: str,
    dtype: str,
    selection: Selection,
    references: dict[tuple[str, str], NDArray[np.float64]],
    say: Say,
) -> list[Cell]:
    """Runs all integrators in one float type; finite differences are kept for the other."""
    stacks, refused = batches(cases, contact)
    methods = [m for m in selection.integrators if m.only is None or contact in m.only]
    methods = [m for m in methods if m.float32 or dtype == "float64"]
    cells = [_refusal(c, contact, m, dtype, refused[c.name]) for m in methods for c in cases if c.name in refused]
    words = limit_of(contact).without_inertia
    unfit = [m for m in methods if words is not None and not m.inertia]
    cells += [_refusal_cell(c, batch, contact, m, dtype) for m in unfit for batch in stacks for c in batch.cases]
    methods = [m for m in methods if m not in unfit]
    for batch in stacks if methods else ():
        starts = starts_of(batch, dtype)
        for method in methods:
            began = time.perf_counter()
            which = short_enough(batch, method)
            if not which:
                continue
            own, own_starts = selected_cases(batch, which), starts_part(starts, which)
            cells += _run_batch(own, own_starts, contact, method, dtype, selection, references)
            say(f"{contact}, {method.name}, {dtype}: {len(which)} cases in {time.perf_counter() - began:.1f} s")
    return cells


def _refusal(case: HardCase, contact: str, method: CaseIntegrator, dtype: str, error: InputError) -> Cell:
    words, outcome, reason = case.expected.refusal, "fail", f"refused: {error}"
    if words is not None:
        right = words in str(error)
        outcome, reason = ("refused", str(error)) if right else ("fail", f"refused for another reason: {error}")
    return Cell(case.name, contact, method.name, dtype, outcome, reason)


def _refusal_cell(case: HardCase, batch: CaseBatch, contact: str, method: CaseIntegrator, dtype: str) -> Cell:
    """The cell of an integrator that must refuse this contact."""
    words = limit_of(contact).without_inertia or ""
    try:
        integrator_from_text(method.name).refuse_unfit(batch.scenes.effects)
    except InputError as error:
        outcome = "refused" if words in str(error) else "fail"
        return Cell(case.name, contact, method.name, dtype, outcome, str(error))
    return Cell(case.name, contact, method.name, dtype, "fail", "not refused")


def _run_batch(
    batch: CaseBatch,
    starts: Starts,
    contact: str,
    method: CaseIntegrator,
    dtype: str,
    selection: Selection,
    references: dict[tuple[str, str], NDArray[np.float64]],
) -> list[Cell]:
    n, double = len(batch.cases), dtype == "float64"
    substeps = jnp.asarray([steps_of(c, method) for c in batch.cases])
    chosen = integrator_from_text(method.name)
    forward = compiled(run, double, integrator=chosen)
    nothing = jnp.zeros((n, len(PARAMETERS)))
    plain = jax.device_get(forward(batch.scenes, starts.chosen, substeps, nothing))
    depth = _depths(batch, plain, double)
    columns = None
    if selection.derivatives and (method.differentiated_on is None or contact in method.differentiated_on):
        columns = np.asarray(compiled(slopes, double, integrator=chosen)(batch.scenes, starts.chosen, substeps))
        if double and any(c.expected.smooth for c in batch.cases):
            found = _references(batch, columns, lambda p: forward(batch.scenes, starts.chosen, substeps, p))
            references.update({(c.name, method.name): found[k] for k, c in enumerate(batch.cases)})
    mates: dict[str, str] = {}
    if selection.mates and n > 1 and contact in PATCHES:  # batched mesh searches compile for minutes
        mates = batch_mates(batch, starts.chosen, substeps, plain, method, dtype)
    runs = {c.name: member(plain, k) for k, c in enumerate(batch.cases)}
    cells = []
    for k, case in enumerate(batch.cases):
        own = None if columns is None else columns[k]
        reference = references.get((case.name, method.name))
        evidence = Evidence(
            runs,
            own,
            reference,
            starts.wrong.get(case.name),
            mates.get(case.name),
            depth[k],
            1 / RATE / int(substeps[k]),
        )
        cells.append(verdict(case, contact, method, dtype, evidence))
    return cells


def _depths(batch: CaseBatch, plain: CaseRun, float64: bool) -> NDArray[np.float64]:
    """(cases, frames): by exhaustive search; NaN at frames of long motions that are skipped."""
    frames = plain.seen.status.shape[1]
    looked = np.arange(0, frames, max(1, frames // MOST_LOOKS))
    centers = jax.tree.map(lambda a: a[:, looked], plain.seen.center)
    depth = np.full((len(batch.cases), frames), np.nan)
    depth[:, looked] = np.asarray(compiled(depths, float64)(batch.scenes, centers))
    return depth


def _references(batch: CaseBatch, slopes: NDArray[Any], forward: Callable[[Any], CaseRun]) -> NDArray[np.float64]:
    """(cases, frames, 7, 4): finite differences of the poses; where some case's differ from slopes, as they settle."""
    found, n = _differences(forward, len(batch.cases)), len(batch.cases)
    smooth = [c.expected.smooth for c in batch.cases]
    off = [k for k in range(n) if smooth[k] and derivatives.disagree(slopes[k], found[k], "float64")]
    if off:
        finer = _differences(forward, n, derivatives.FINER)
        found[off] = [derivatives.agreeing_differences(found[k], finer[k]) for k in off]
    return found


def _differences(forward: Callable[[Any], CaseRun], n: int, share: float = 1.0) -> NDArray[np.float64]:
    """(cases, frames, 7, 4): central differences of the poses."""
    sides = [
        [np.asarray(poses(forward(jnp.tile(jnp.asarray(p), (n, 1))).states)) for p in side]
        for side in derivatives.parameter_changes(share)
    ]
    return derivatives.differences(np.stack(sides[0]), np.stack(sides[1]), share)
