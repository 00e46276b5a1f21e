"""How long steps may be on a scene, found by doubling their number on that very scene.

`accurate_enough` starts from a step and halves it until the estimated errors of path and contact force are small.
`coarsest` looks for the longest step that holds a tolerance, of the path (the root of the mean square over all frames)
or of the contact force (the largest of all frames). Estimates: `pftwin.dynamics.error_estimate`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
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

    @property
    def settings(self) -> dict[str, Any]:
        """What a result should say of it, beside the steps."""
        return {}


@dataclass(frozen=True)
class Held(Choice[Run]):
    """The choice for a tolerance."""

    tolerance: Tolerance
    tried: dict[int, float]  # estimates of all that was tried [m or N]

    @property
    def estimate(self) -> float:
        """What of the error is to stay within the tolerance [m or N]."""
        return self.tried[self.substeps]

    @property
    def held(self) -> bool:
        """Whether it is."""
        return self.estimate <= self.tolerance.value

    @property
    def settings(self) -> dict[str, Any]:
        """The tolerance, the estimate, and whether it is held."""
        unit = self.tolerance.unit
        found = {f"tolerance_{unit}": self.tolerance.value, f"estimated_error_{unit}": self.estimate}
        return {**found, "tolerance_held": self.held}


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


def coarsest(run: Callable[[int], Tried[Run]], order: float, tolerance: Tolerance) -> Held[Run]:
    """The fewest steps between two frames, of 1, 2, 4, ..., that hold the tolerance.

    Args:
        run: from a number of steps to what is to be kept.
        order: of the integrator.
        tolerance: of path or force.

    Warns where none holds it: the finest that an error is known of is then the choice.
    """
    tried: dict[int, float] = {}
    n, here = 1, run(1)
    while True:
        finer = run(2 * n)
        error = _error_of(here, finer, order, 0.5)
        tried[n] = found = tolerance.measure(error)
        if found <= tolerance.value or 2 * n >= MOST_SUBSTEPS:
            break
        n, here = 2 * n, finer
    if found > tolerance.value:
        warnings.warn(
            f"a tolerance of {tolerance.text(tolerance.value)} is not met with {n} steps between two frames:"
            f" the estimated error is {tolerance.text(found)}",
            PftwinWarning,
            stacklevel=4,
        )
    return Held(here.run, n, error, tolerance, tried)


def _error_of(run: Tried[Any], other: Tried[Any], order: float, ratio: float) -> ErrorEstimate:
    """As `error_of`, infinite where one of the runs does not count."""
    error = error_of(run.course, other.course, order, ratio)
    return error if run.sound and other.sound else error.unknown
