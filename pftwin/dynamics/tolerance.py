"""How long steps may be on a scene, found by doubling their number on that very scene.

`accurate_enough` starts from a step and halves it until the estimated errors of path and contact force are small.
`coarsest` looks for the longest step that holds a tolerance, of the path (the root of the mean square over all frames)
or of the contact force (the largest of all frames). Estimates: `pftwin.dynamics.error_estimate`.
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
HALVINGS = 2  # of the first step, at most, where no step was asked for


class Tolerance(NamedTuple):
    """How far off a run may be."""

    value: float
    unit: str  # "m" of the path, "N" of the contact force

    def measure(self, error: ErrorEstimate) -> float:
        """The one number of an estimate that has to stay within it."""
        if self.unit == "N":
            return float(np.max(error.contact_force))
        return float(np.sqrt(np.mean(np.square(error.path))))

    def text(self, value: float) -> str:
        """A number of its kind, for people."""
        return f"{value:.3g} N" if self.unit == "N" else f"{1e3 * value:.3g} mm"


class Tried(NamedTuple, Generic[Run]):
    """A run that was made."""

    run: Run  # what is kept of it
    course: Course
    sound: bool  # whether its steps were short enough for it to count at all


@dataclass(frozen=True)
class Choice(Generic[Run]):
    """A number of steps between two frames, and what is known of its error."""

    run: Run  # what was computed with it
    substeps: int
    error: ErrorEstimate
    settings: dict[str, Any] = field(default_factory=dict)  # what a result should say of it, beside the steps


def parse_tolerance(given: str | float) -> Tolerance:
    """From "0.05 mm" or "0.5 N", or a number of metres.

    Raises:
        InputError: no positive length or force.
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


def with_estimate(run: Callable[[int], Tried[Run]], n: int, order: float) -> Choice[Run]:
    """A run of n steps between two frames, with the estimate of its error from one of half as many.

    Where that says that it is large, it may be the other run that is wrong: one of twice as many then decides.
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
    """From n steps between two frames, an even number: as many as it takes for a small error, at most `HALVINGS` on.

    An estimate from the first pair counts double; later ones are not below what the estimate before leads to expect.
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
    """The fewest steps between two frames, of 1, 2, 4, ..., that hold the tolerance.

    Its settings tell the tolerance, the estimate of what is to stay within it, and whether it does.

    Warns where none holds it: the finest that an error is known of is then the choice. Raises InputError: a tolerance
    of the contact force where there is none.
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
            f"a tolerance of {tolerance.text(tolerance.value)} is not met with {n} steps between two frames:"
            f" the estimated error is {tolerance.text(found)}",
            PftwinWarning,
            stacklevel=4,
        )
    told = {f"tolerance_{tolerance.unit}": tolerance.value, f"estimated_error_{tolerance.unit}": found}
    return Choice(here.run, n, error, {**told, "tolerance_held": held})


def _error_of(run: Tried[Any], other: Tried[Any], order: float, ratio: float) -> ErrorEstimate:
    """As `error_of`, infinite where one of the runs does not count."""
    error = error_of(run.course, other.course, order, ratio)
    return error if run.sound and other.sound else error.unknown
