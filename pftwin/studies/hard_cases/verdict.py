"""The verdict on one cell of the matrix: pass, fail or refused, with the reason; and errors against a converged run.

The converged run uses BDF2 in float64 with steps of 1/64 ms (1/32 ms on meshes, where a step costs more). Its own
uncertainty is its difference from a run with twice the step, as the maximum up to each frame. Errors within twice that
uncertainty are not judged: neighbouring solutions of a chaotic motion have no common limit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.leaves import host_array
from pftwin.dynamics.equilibrium import converged_on_host
from pftwin.dynamics.error_estimate import Course, ErrorEstimate, course_difference
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.rebound import impact_of
from pftwin.dynamics.status import ALLOWED_PATH_ERROR, Status
from pftwin.model.scene import Scene
from pftwin.results.verdict import most_frames, verdict_of
from pftwin.studies.hard_cases import derivatives, invariants
from pftwin.studies.hard_cases.batch import BatchRuns, CaseBatch
from pftwin.studies.hard_cases.case import RELEASED, UNKNOWN, CaseIntegrator, HardCase, limit_of
from pftwin.studies.hard_cases.contacts import MESHES
from pftwin.studies.hard_cases.derivatives import Reference
from pftwin.studies.hard_cases.invariants import CHECKS, ERRORS, GEOMETRY, TOLERANCES, Look
from pftwin.studies.hard_cases.programs import CaseRun, poses

FINE = {"patch": 320, "mesh": 160}  # steps per frame interval, 10 ms, of the coarser converged runs

MIDDLE = 1e-5  # closer to the plane of symmetry, rounding decides whether a single contact is medial or lateral [m]
QUANTITIES = ("path", "contact_force", "medial_facet", "lateral_facet")  # of `ErrorEstimate`
# Flags of a run or a step that cannot be trusted.
REFUSES = Status.STEP_TOO_LONG | Status.SEARCH_OVERFLOW | Status.ENERGY_FROM_NOWHERE
# Appears in the reason of a cell that is refused for its estimated error although a converged run confirms it.
THOUGH_RIGHT = "though right in place and force, by a converged run"


class Truth(NamedTuple):
    """A converged run of one case."""

    course: Course
    left: ErrorEstimate  # its uncertainty at every frame

    def finds_right(self, ran: CaseRun) -> bool:
        """Whether a run is accurate even with the uncertainty added, except in as many frames as a verdict allows."""
        return expected_flags(self.off(ran, 2.0))[1] <= most_frames(Status.INACCURATE, len(self.course.center))

    def off(self, ran: CaseRun, known_to: float) -> ErrorEstimate:
        """Returns the difference of a run from this one at every frame, plus `known_to` times the uncertainty."""
        found = course_difference(Course.of(ran.observation, "contact"), self.course)
        off = (getattr(found, n) + known_to * getattr(self.left, n) for n in QUANTITIES)
        path, force, *facets = (np.maximum(a, 0.0) for a in off)
        middle = np.abs(self.course.center[:, 1]) < MIDDLE
        return found.with_errors(path, force, *(np.where(middle, 0.0, f) for f in facets))


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
        left = course_difference(course, coarse)
        values = (np.maximum.accumulate(getattr(left, name)) for name in QUANTITIES)
        found[case.name] = Truth(course, left.with_errors(*values))
    return found


def restitution_remarked(scene: Scene, ran: CaseRun, integrator: Integrator, step: float) -> bool:
    """Whether the result remarks that its steps are too long to resolve the contact's restitution."""
    impact = impact_of(scene, integrator, step, float(ran.ledger.approach[-1]))
    return impact is not None and impact.unresolved


def expected_flags(off: ErrorEstimate) -> tuple[NDArray[np.int64], int]:
    """Returns the flags that a run with these errors should have (n,), and its number of INACCURATE frames."""
    wrong = np.asarray(off.flags_beyond(ALLOWED_PATH_ERROR), np.int64)
    return wrong, int(((wrong & int(Status.INACCURATE)) > 0).sum())


# Flags that are unrelated to the error of the steps.
_UNRELATED = int(Status.START_NOT_IN_EQUILIBRIUM | Status.NO_CONTACT | Status.DEEP_INDENTATION)


def silent_error(ran: CaseRun, truth: Truth, remarked: Callable[[], bool] = lambda: False) -> str | None:
    """Describes an error that a run does not report by flags, verdict or remark; None if there is none."""
    off, flags = truth.off(ran, -2.0), np.asarray(ran.observation.status, np.int64)
    (wrong, frames), said = expected_flags(off), Status(int(np.bitwise_or.reduce(flags)))
    enough = Status.INACCURATE | UNKNOWN
    pairs = (Status.INACCURATE, enough), (Status.FACETS_INACCURATE, Status.FACETS_INACCURATE | enough)
    if any((wrong & int(flag)).any() and not said & reported for flag, reported in pairs):
        words = f"off a converged run by {off.describe()}, and no frame says so"
    elif frames > most_frames(Status.INACCURATE, flags.size) and verdict_of(flags & ~_UNRELATED).valid:
        words = f"off a converged run in {frames} of {flags.size} frames, by {off.describe()}, and called valid"
    else:
        return None
    return None if remarked() else words


class Cell(NamedTuple):
    """One case with one kind of contact, integrator and float type."""

    case: str
    contact: str
    integrator: str
    dtype: str
    outcome: str  # "pass", "fail" or "refused"
    reason: str  # why it is not a pass


class Evidence(NamedTuple):
    """The evidence on which one case is judged."""

    runs: dict[str, CaseRun]  # runs of the whole batch, on the host
    slopes: NDArray[np.float64] | None  # (n, 7, 4) derivatives
    reference: Reference | None  # finite differences for the derivatives
    start: str | None  # faults of the equilibrium
    batch_dependence: str | None  # dependence on the batch
    depth: NDArray[np.float64]  # (n,) penetration by exhaustive search [m]
    step: float  # [s]
    truth: Truth | None = None  # a converged run
    remarked: Callable[[], bool] = lambda: False  # whether the result remarks that restitution is not resolved


def verdict(case: HardCase, contact: str, method: CaseIntegrator, dtype: str, evidence: Evidence) -> Cell:
    """Judges a run: "pass", "fail" with all faults, or "refused" if the run itself reports that it is not reliable."""
    run, tolerance = evidence.runs[case.name], TOLERANCES[dtype]
    look = Look(case, case.builder(), contact, run, tolerance, evidence.step, evidence.depth, method.inertia)

    def cell(outcome: str, reason: str) -> Cell:
        return Cell(case.name, contact, method.name, dtype, outcome, reason)

    if case.expected.refusal is not None:
        return cell("fail", "not refused")
    every = Status(int(np.bitwise_or.reduce(look.flags)))
    if every & RELEASED and dtype in case.no_equilibrium.get(contact, ()):
        return cell("refused", f"{RELEASED.describe()} ({case.limit})")  # flagged in every frame
    said = Status.PEAK_UNKNOWN if every & Status.PEAK_UNKNOWN else Status.INACCURATE
    inaccurate = int(((look.flags & int(said)) > 0).sum())
    invalid = inaccurate > most_frames(said, look.flags.size)  # by the estimated error of the steps
    if every & UNKNOWN and (method.may_refuse or invalid or case.expected.may & UNKNOWN or _at_limit(look)):
        return _refused(look, every, cell)
    found = [
        *(check(look) for check in CHECKS),
        evidence.start,
        evidence.batch_dependence,
        _equals_other_case(look, evidence),
        _slopes(look, evidence, dtype, invalid),
        None if evidence.truth is None else silent_error(run, evidence.truth, evidence.remarked),
    ]
    if wrong := [words for words in found if words]:
        return cell("fail", "; ".join(wrong))
    if invalid:
        doubt = f"; {THOUGH_RIGHT}" if evidence.truth is not None and evidence.truth.finds_right(run) else ""
        return cell("refused", f"{said.describe()} ({inaccurate} of {look.flags.size} frames){doubt}")
    return cell("pass", "")


def _at_limit(look: Look) -> bool:
    """Whether a run first rejects itself for a known limit of its kind of contact, with nothing unexpected before."""
    limit, first = limit_of(look.contact), int(np.argmax((look.flags & int(UNKNOWN)) > 0))
    until = Status(int(np.bitwise_or.reduce(look.flags[: first + 1])))
    own = limit.flags | (limit.at_rim if Status.LEFT_PATCH in until else Status.OK)
    allowed = look.case.expected.may | look.case.expected.must | GEOMETRY | ERRORS | own
    return bool(look.flags[first] & int(own)) and not until & ~allowed


def _refused(look: Look, every: Status, cell: Callable[[str, str], Cell]) -> Cell:
    """A run that rejects itself must do so by the first frame that is not finite, and be right until then."""
    flags = look.flags
    lost, said = (flags & int(Status.NOT_FINITE)) > 0, (flags & int(REFUSES)) > 0
    first = np.argmax(lost) if lost.any() else len(flags)
    if lost.any() and not said[: first + 1].any():
        return cell("fail", f"not finite from frame {first + 1}, and nothing said before")
    skipped = {invariants.finite, invariants.flags_allowed, invariants.at_end, invariants.stays_in_place}
    if every & Status.ENERGY_FROM_NOWHERE:
        skipped |= {invariants.energy, invariants.penetration}  # the run itself flags the created energy
    wrong = [w for check in CHECKS if check not in skipped and (w := check(look)) is not None]
    if wrong:
        return cell("fail", "before it refuses itself: " + "; ".join(wrong))
    return cell("refused", (every & UNKNOWN).describe())


def _equals_other_case(look: Look, evidence: Evidence) -> str | None:
    """Checks that the motion equals that of another case."""
    other = look.case.expected.same_as
    if other is None:
        return None
    off = np.abs(np.subtract(*(host_array(r.states.position) for r in (look.run, evidence.runs[other])))).max()
    return f"{1e3 * off:.2g} mm from {other}" if not off <= look.tolerance.same else None


def _slopes(look: Look, evidence: Evidence, dtype: str, invalid: bool) -> str | None:
    """Checks that derivatives are finite before any rejected frame, and correct if the motion is smooth."""
    if evidence.slopes is None:
        return None
    own = np.asarray(evidence.slopes, np.float64)
    if words := derivatives.not_finite(own, look.clean()):
        return words
    if not look.case.expected.smooth or evidence.reference is None:
        return None
    words = derivatives.disagree(own, evidence.reference.differences, dtype)
    if words is None or dtype == "float64":
        return words
    known = derivatives.known_on(evidence.reference, np.asarray(poses(look.run.states), np.float64))
    if invalid and not np.isfinite(known).any():  # rounding changes its start, and it is reported as invalid
        return None
    return derivatives.disagree(own, known, dtype)
