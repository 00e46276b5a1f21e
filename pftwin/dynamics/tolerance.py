"""The longest step that holds a tolerance on a scene, found by doubling the number of steps on that very scene.

The error of n steps between two frames is told from the distance to 2 n steps: where errors fall with the power p of
the step, e(n) = |x(n) - x(2 n)| / (1 - 2^-p). Contacts that open and close cost part of an integrator's order, so p is
taken as half of what it declares. Distance is the root of the mean square, over all frames, of how far the patella's
points within 20 mm of the tracked one are apart at most.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError, PftwinWarning

Floats = NDArray[np.float64]
Run = TypeVar("Run")

REACH = 0.02  # of the points that count, from the tracked one [m]
MOST_SUBSTEPS = 256
UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}


class Path(NamedTuple):
    """Where the patella is at the frames; leading axes of batches are allowed."""

    center: Floats  # (..., n, 3) tracked point, femur frame [m]
    quaternion: Floats  # (..., n, 4)


@dataclass(frozen=True)
class Choice(Generic[Run]):
    """A number of steps between two frames, and what is known of its error."""

    run: Run  # what was computed with it
    substeps: int
    error: float  # estimated, rms [m]
    held: bool  # whether that is within the tolerance
    tried: dict[int, float]  # estimates of all that was tried [m]


def tolerance_in_metres(given: str | float) -> float:
    """From "0.05 mm", or a number of metres.

    Raises:
        InputError: no positive length.
    """
    number, unit = given, "m"
    if isinstance(given, str):
        match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*([a-zµ]*)\s*", given)
        number, unit = (match[1], match[2] or "?") if match else (given, "?")
    try:
        value = float(number) * UNITS[unit]
    except (KeyError, ValueError, TypeError):
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"found {given!r}", where="tolerance", expected='a length such as "0.05 mm"')
    return value


def distance(a: Path, b: Path) -> Floats:
    """Root mean square over the frames of how far two paths are apart (...,) [m]; infinite where one is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.linalg.norm(a.center - b.center, axis=-1)
        cosine = np.abs(np.sum(a.quaternion * b.quaternion, axis=-1))
        sine = np.sqrt(np.clip(1 - cosine**2, 0, 1))
        turned = 2 * np.arctan2(sine, cosine)
        found = np.sqrt(np.mean(np.square(apart + REACH * turned), axis=-1))
    return np.where(np.isfinite(found), found, np.inf)


def estimated_error(coarse: Path, fine: Path, order: float) -> Floats:
    """Of the coarse path, from one of twice as many steps (...,) [m]."""
    return distance(coarse, fine) / (1 - 2 ** (-order / 2))


def coarsest(run: Callable[[int], tuple[Run, Path, bool]], order: float, tolerance: float) -> Choice[Run]:
    """The fewest steps between two frames, of 1, 2, 4, ..., that hold the tolerance.

    Args:
        run: from a number of steps to what is to be kept, its path, and whether its steps were short enough for it to
            count at all.
        order: of the integrator.
        tolerance: [m].

    Warns where none holds it: the finest that an error is known of is then the choice.
    """
    tried: dict[int, float] = {}
    n, (kept, path, sound) = 1, run(1)
    while True:
        finer = run(2 * n)
        error = float(estimated_error(path, finer[1], order)) if sound and finer[2] else math.inf
        tried[n] = error
        if error <= tolerance or 2 * n >= MOST_SUBSTEPS:
            break
        n, (kept, path, sound) = 2 * n, finer
    if error > tolerance:
        warnings.warn(
            f"a tolerance of {1e3 * tolerance:g} mm is not met with {n} steps between two frames:"
            f" the estimated error is {1e3 * error:.3g} mm",
            PftwinWarning,
            stacklevel=4,
        )
    return Choice(kept, n, error, error <= tolerance, tried)


def settings_of(choice: Choice[Any], tolerance: float) -> dict[str, Any]:
    """What a result should say of it."""
    return {"tolerance_m": tolerance, "estimated_error_m": choice.error, "tolerance_held": choice.held}
