"""Errors of runs: the estimate that `pftwin.simulate` makes, and the difference from a converged run.

The converged run uses BDF2 in float64 with steps of 1/64 ms (1/32 ms on meshes, where a step costs more). Its own
uncertainty is its difference from a run with twice the step, as the maximum up to each frame. Errors within twice that
uncertainty are not judged: neighbouring solutions of a chaotic motion have no common limit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.dynamics.equilibrium import converged_on_host, place_unknown
from pftwin.dynamics.error_estimate import Course, ErrorEstimate, apart
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.rebound import impact_of
from pftwin.dynamics.status import ALLOWED_PATH_ERROR, Status
from pftwin.dynamics.tolerance import Choice, Tried, accurate_enough, with_estimate
from pftwin.model.scene import Scene
from pftwin.results.verdict import most_frames, verdict_of
from pftwin.studies.hard_cases.batch import CaseBatch, member
from pftwin.studies.hard_cases.case import UNKNOWN, CaseIntegrator
from pftwin.studies.hard_cases.contacts import MESHES
from pftwin.studies.hard_cases.programs import PARAMETERS, CaseRun, compiled, run

FINE = {"patch": 320, "mesh": 160}  # steps per frame interval, 10 ms, of the coarser converged runs

MIDDLE = 1e-5  # closer to the plane of symmetry, rounding decides whether a single contact is medial or lateral [m]
QUANTITIES = ("path", "contact_force", "medial_facet", "lateral_facet")  # of `ErrorEstimate`


class BatchRuns:
    """Runs of a batch's cases with any number of steps, by one compiled program; each run is cached."""

    def __init__(self, batch: CaseBatch, starts: Any, integrator: Integrator, float64: bool) -> None:
        """Prepares the program; makes no run yet."""
        self._program = compiled(run, float64, integrator=integrator)
        self._batch, self._starts = batch, starts
        self._kept: dict[tuple[int, int], CaseRun] = {}

    def with_parameters(self, substeps: Sequence[int], p: Any, only: Sequence[int]) -> CaseRun:
        """Runs the cases `only` with parameters changed by p (4,); returns stacked runs."""
        n = len(self._batch.cases)
        steps, changes = np.asarray(substeps, int), np.tile(np.asarray(p), (n, 1))
        return self._program(self._batch.scenes, self._starts, jnp.asarray(steps), jnp.asarray(changes), only=only)

    def tried(self, k: int, n: int) -> Tried[CaseRun]:
        """Returns the run of case k with n steps per frame."""
        if (k, n) not in self._kept:
            ran = self.with_parameters([n] * len(self._batch.cases), np.zeros(len(PARAMETERS)), [k])
            self._kept[k, n] = member(ran, 0)
        found = self._kept[k, n]
        return Tried(found, Course.of(found.seen, "contact"), not (found.seen.status & int(Status.STEP_TOO_LONG)).any())

    def chosen(self, substeps: Sequence[int], method: CaseIntegrator) -> list[Choice[CaseRun]]:
        """Returns runs with these steps, or with those that `pftwin.simulate` chooses from there, with error flags."""
        choose = accurate_enough if method.chooses_steps else with_estimate
        found = []
        for k, n in enumerate(substeps):
            choice = choose(partial(self.tried, k), n, method.integrator.order)
            error = choice.error.with_start(place_unknown(member(self._starts, k)))
            flagged = eqx.tree_at(lambda r: r.seen.status, choice.run, choice.run.seen.status | error.flags)
            found.append(replace(choice, run=flagged, error=error))
        return found


class Truth(NamedTuple):
    """A converged run of one case."""

    course: Course
    left: ErrorEstimate  # its uncertainty at every frame

    def finds_right(self, ran: CaseRun) -> bool:
        """Whether a run is accurate even with the uncertainty added, except in as many frames as a verdict allows."""
        return deserved(self.off(ran, 2.0))[1] <= most_frames(Status.INACCURATE, len(self.course.center))

    def off(self, ran: CaseRun, known_to: float) -> ErrorEstimate:
        """Returns the difference of a run from this one at every frame, plus `known_to` times the uncertainty."""
        found = apart(Course.of(ran.seen, "contact"), self.course)
        off = (getattr(found, n) + known_to * getattr(self.left, n) for n in QUANTITIES)
        path, force, *facets = (np.maximum(a, 0.0) for a in off)
        middle = np.abs(self.course.center[:, 1]) < MIDDLE
        return ErrorEstimate(path, force, *(np.where(middle, 0.0, f) for f in facets), most_force=found.most_force)


def truths(batch: CaseBatch, starts: Any, contact: str) -> dict[str, Truth]:
    """Returns converged runs of a batch's cases, by name; float64 must be enabled.

    A case whose starting equilibrium was not found is omitted: its run is flagged in every frame, and a float32 run
    that starts elsewhere is not wrong for that reason.
    """
    fine, runs = FINE["mesh" if contact in MESHES else "patch"], BatchRuns(batch, starts, BDF2(), True)
    found, at_rest = {}, converged_on_host(starts)
    for k, case in enumerate(batch.cases):
        if not (case.released or at_rest[k]):
            continue
        coarse, course = (runs.tried(k, steps).course for steps in (fine, 2 * fine))
        left = apart(course, coarse)
        values = (np.maximum.accumulate(getattr(left, name)) for name in QUANTITIES)
        found[case.name] = Truth(course, ErrorEstimate(*values, most_force=left.most_force))
    return found


def restitution_remarked(scene: Scene, ran: CaseRun, integrator: Integrator, step: float) -> bool:
    """Whether the result remarks that its steps are too long to resolve the contact's restitution."""
    impact = impact_of(scene, integrator, step, float(ran.ledger.approach[-1]))
    return impact is not None and impact.unresolved


def deserved(off: ErrorEstimate) -> tuple[NDArray[np.int64], int]:
    """Returns the flags that a run with these errors should have (n,), and its number of INACCURATE frames."""
    wrong = np.asarray(off.flags_beyond(ALLOWED_PATH_ERROR), np.int64)
    return wrong, int(((wrong & int(Status.INACCURATE)) > 0).sum())


# Flags that are unrelated to the error of the steps.
_UNRELATED = int(Status.START_NOT_IN_EQUILIBRIUM | Status.NO_CONTACT | Status.DEEP_INDENTATION)


def silent_error(ran: CaseRun, truth: Truth, remarked: Callable[[], bool] = lambda: False) -> str | None:
    """Describes an error that a run does not report by flags, verdict or remark; None if there is none."""
    off, flags = truth.off(ran, -2.0), np.asarray(ran.seen.status, np.int64)
    (wrong, frames), said = deserved(off), Status(int(np.bitwise_or.reduce(flags)))
    enough = Status.INACCURATE | UNKNOWN
    pairs = (Status.INACCURATE, enough), (Status.FACETS_INACCURATE, Status.FACETS_INACCURATE | enough)
    if any((wrong & int(flag)).any() and not said & told for flag, told in pairs):
        words = f"off a converged run by {off.describe()}, and no frame says so"
    elif frames > most_frames(Status.INACCURATE, flags.size) and verdict_of(flags & ~_UNRELATED).valid:
        words = f"off a converged run in {frames} of {flags.size} frames, by {off.describe()}, and called valid"
    else:
        return None
    return None if remarked() else words
