"""Choice of the step for a scene from error estimates, by doubling the number of steps.

`accurate_enough` starts from a step and halves it until the estimated errors of path and contact force are small.
`coarsest` finds the longest step that meets a tolerance of the path (root mean square over all frames) or of the
contact force (largest error of all frames). The contact force is that of both facets together: the force on one facet
may have a larger error, which has its own estimate and flag. Estimates: `pftwin.dynamics.error_estimate`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.written_amounts import UNITS, number_and_unit
from pftwin.dynamics.error_estimate import Course, ErrorEstimate, after_halving, error_of

Run = TypeVar("Run")

MOST_SUBSTEPS = 256
UNCONFIRMED = 2.0  # factor on an estimate from the first pair of runs
HALVINGS = 2  # largest number of halvings of the default step


class Tolerance(NamedTuple):
    """Accepted error of a run."""

    value: float
    unit: str  # "m" for the path, "N" for the contact force

    def measure(self, error: ErrorEstimate) -> float:
        """The number of an estimate that is compared with the tolerance."""
        if self.unit == "N":
            return float(np.max(error.contact_force))
        return float(np.sqrt(np.mean(np.square(error.path))))

    @property
    def of(self) -> str:
        """What the tolerance is of."""
        return "contact force, both facets together" if self.unit == "N" else "path, rms over the frames"

    def text(self, value: float) -> str:
        """Formats a value with the tolerance's kind of unit."""
        return f"{value:.3g} N" if self.unit == "N" else f"{1e3 * value:.3g} mm"


class Tried(NamedTuple, Generic[Run]):
    """A completed run."""

    run: Run  # its output
    course: Course
    sound: bool  # whether its steps were short enough to use it in an estimate


@dataclass(frozen=True)
class Choice(Generic[Run]):
    """The chosen number of steps between two frames, with its run and error estimate."""

    run: Run  # output of the run with it
    substeps: int
    error: ErrorEstimate
    settings: dict[str, Any] = field(default_factory=dict)  # additional settings for the result


def parse_tolerance(given: str | float) -> Tolerance:
    """Parses "0.05 mm" or "0.5 N", or a number in metres.

    Raises:
        InputError: it is not a positive length or force.
    """
    written = number_and_unit(given) if isinstance(given, str) else (given, "m")
    number, unit = written or (math.nan, "m")
    kind = "N" if unit in UNITS["N"] else "m"
    try:
        value = float(number) * UNITS[kind].get(unit, math.nan)
    except (TypeError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        expected = 'a length such as "0.05 mm", or a force such as "0.5 N"'
        raise InputError(f"found {given!r}", where="tolerance", expected=expected)
    return Tolerance(value, kind)


def most_runs(n: int, *, fixed: bool, tolerance: bool) -> list[int]:
    """Numbers of steps between two frames of the runs that a choice may need, in their order; it needs the first two.

    `fixed`: for `with_estimate`; `tolerance`: for `coarsest`; neither: for `accurate_enough`.
    """
    if tolerance:
        return [2**k for k in range(MOST_SUBSTEPS.bit_length())]
    if fixed:
        return [n, *([n // 2] if n > 1 else []), 2 * n]
    return [n // 2, *(n * 2**k for k in range(1 + HALVINGS))]


def with_estimate(run: Callable[[int], Tried[Run]], n: int, order: float) -> Choice[Run]:
    """A run with n steps between two frames, and its error estimate from a run with half as many.

    If this estimate is large, possibly only the coarser run is inaccurate: a run with twice as many then decides.
    """
    here = run(n)
    if n > 1:
        coarse = run(n // 2)
        error = _error_of(here, coarse, order, n / (n // 2))
        if error.small:
            return Choice(here.run, n, error)
    fine = run(2 * n)
    return Choice(here.run, n, _error_of(here, fine, order, 0.5))


def accurate_enough(run: Callable[[int], Tried[Run]], n: int, order: float) -> Choice[Run]:
    """Doubles n steps between two frames (an even number) until the error is small, at most `HALVINGS` times.

    The estimate from the first pair of runs is doubled; later ones are at least what the previous estimate predicts.
    """
    coarse, here = run(n // 2), run(n)
    error = pair = _error_of(here, coarse, order, 2.0)
    error = error.times(UNCONFIRMED, UNCONFIRMED)
    for _ in range(HALVINGS):
        if error.small:
            break
        n, before, coarse, here = 2 * n, after_halving(pair, order), here, run(2 * n)
        pair = _error_of(here, coarse, order, 2.0)
        error = pair.or_larger(before)
    return Choice(here.run, n, error)


def coarsest(run: Callable[[int], Tried[Run]], order: float, tolerance: Tolerance) -> Choice[Run]:
    """Smallest number of steps between two frames, of 1, 2, 4, ..., that meets the tolerance.

    The settings of the choice contain the tolerance, what it is of, the estimated error, and whether it meets the
    tolerance.

    Warns if none does; the choice is then the largest number with an error estimate. Raises InputError for a tolerance
    of the contact force if there is no contact force.
    """
    n, here = 1, run(1)
    while True:
        finer = run(2 * n)
        if tolerance.unit == "N" and not (np.any(here.course.force) or np.any(finer.course.force)):
            raise InputError(
                "there is no contact force in the whole motion",
                where="tolerance",
                expected='a length, such as "0.05 mm"',
            )
        error = _error_of(here, finer, order, 0.5)
        found = tolerance.measure(error)
        held = found <= tolerance.value
        if held or 2 * n >= MOST_SUBSTEPS:
            break
        n, here = 2 * n, finer
    if not held:
        warnings.warn(
            f"a tolerance of {tolerance.text(tolerance.value)} ({tolerance.of}) is not met with {n} steps between two"
            f" frames: the estimated error is {tolerance.text(found)}",
            PftwinWarning,
            stacklevel=4,
        )
    settings = {f"tolerance_{tolerance.unit}": tolerance.value, f"estimated_error_{tolerance.unit}": found}
    return Choice(here.run, n, error, {**settings, "tolerance_held": held, "tolerance_of": tolerance.of})


def _error_of(run: Tried[Any], other: Tried[Any], order: float, ratio: float) -> ErrorEstimate:
    """As `error_of`, but infinite if one of the runs is not sound."""
    error = error_of(run.course, other.course, order, ratio)
    return error if run.sound and other.sound else error.unknown
