"""The smallest treatment that meets stated limits: a batched grid over the surgeon's range, then gradients.

The grid finds where limits can be met at all, also where outcomes jump (dislocation). From its best amounts sequential
quadratic programming (scipy's SLSQP) goes on with forward-mode derivatives of the smooth outcomes; a step that leads
nowhere better is not taken, so the answer always meets the limits by a simulation of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.limits import Limit
from fitting.predict import STEP, Fitted, predict
from fitting.refine import Search, refined
from fitting.treatments import Treatment
from fitting.variants import grid
from pftwin.errors import InputError
from pftwin.scene import Scene
from pftwin.tracking import DISLOCATED

_GRID = {1: 41, 2: 15, 3: 8}  # points to a side, by the number of amounts
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """What was found."""

    met: bool  # whether any amounts within the range meet all limits
    treatment: Treatment  # the smallest that does; where none does, the one that breaks them least
    outcomes: dict[str, float]  # with it, SI
    limits: tuple[Limit, ...]
    simulations: int

    def describe(self) -> str:
        """In a sentence or two."""
        if self.met:
            said = [f"{lim.outcome.replace('_', ' ')} {self.outcomes[lim.outcome]:.4g}" for lim in self.limits]
            return f"smallest that meets the limits: {self.treatment.describe()} ({', '.join(said)})"
        broken = [lim.describe() for lim in self.limits if not lim.room(self.outcomes[lim.outcome]) >= 0]
        return (
            f"no amount within the range meets the limits; nearest: {self.treatment.describe()}, "
            f"which breaks {'; '.join(broken)}"
        )


def optimise_treatment(
    scene: Scene,
    limits: Limit | Sequence[Limit],
    ranges: Mapping[str, tuple[float, float]] | None = None,
    treatment: str | Treatment = "tibial_tuberosity_transfer",
    estimate: Fitted | None = None,
    *,
    dt: float = STEP,
    threshold: float = DISLOCATED,
) -> Plan:
    """The smallest treatment that meets the limits.

        optimise_treatment(scene, Limit("dislocation_margin", at_least=0.003), {"medialisation": (0.0, 0.020)})

    Smallest is measured by the amounts, each as a share of its range's larger end, as the root of the sum of squares.

    Args:
        scene: untreated.
        limits: all of which are to be met.
        ranges: what the surgeon can do, by amount (SI, one to three amounts); amounts that are not named stay as the
            treatment has them. By default medialisation from 0 to 20 mm.
        treatment: its kind, or a treatment that has these amounts.
        estimate: parameters in the place of the scene's own.
        dt: longest time step [s].
        threshold: distance from the groove's bottom beyond which the button counts as dislocated [m].

    Returns:
        A plan; where no amount within the range meets the limits it says so and holds the nearest.

    Raises:
        InputError: no limits, ranges that are empty, four amounts or more, a scene without what is to be changed.
    """
    wanted = (limits,) if isinstance(limits, Limit) else tuple(limits)
    ranges = dict(ranges or {"medialisation": (0.0, 0.020)})
    lower, upper = _checked(wanted, ranges)
    if isinstance(treatment, str):
        treatment = Treatment.of(treatment, dict.fromkeys(ranges, 0.0))
    axes = [np.linspace(a, b, _GRID[len(ranges)]) for a, b in zip(lower, upper, strict=True)]
    data = predict(scene, grid(treatment, dict(zip(ranges, axes, strict=True))), estimate, dt=dt, threshold=threshold)
    amounts = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    values = {lim.outcome: _si(data[lim.outcome]) for lim in wanted}
    scale = np.maximum(np.abs(lower), np.abs(upper))
    room = np.stack([lim.room(values[lim.outcome]) / lim.size for lim in wanted], axis=1)
    room = np.where(np.isfinite(room), room, -np.inf)
    effort = np.linalg.norm(amounts / scale, axis=1)
    fine = (room >= 0).all(axis=1)
    search = Search(scene, treatment, tuple(ranges), estimate, wanted, dt, threshold)
    if not fine.any():
        best = amounts[int(np.argmax(room.min(axis=1)))]
        found = search.outcomes(best)
        return Plan(False, search.treated(best), found, wanted, len(amounts) + search.count)
    best = amounts[fine][int(np.argmin(effort[fine]))]
    if np.linalg.norm(best / scale) > 0:
        best = refined(search, best, lower, upper, scale)
    return Plan(True, search.treated(best), search.outcomes(best), wanted, len(amounts) + search.count)


def _checked(limits: tuple[Limit, ...], ranges: dict[str, tuple[float, float]]) -> tuple[Floats, Floats]:
    if not limits or not all(isinstance(lim, Limit) for lim in limits):
        raise InputError(
            f"found {limits!r}", where="limits", expected='limits such as Limit("largest_offset", at_most=0.01)'
        )
    if len(ranges) > max(_GRID):
        raise InputError(f"{len(ranges)} amounts", where="ranges", expected=f"at most {max(_GRID)}")
    for name, pair in ranges.items():
        try:
            low, high = (float(v) for v in pair)
        except (TypeError, ValueError):
            low = high = np.nan
        if not low < high or not np.isfinite([low, high]).all():
            raise InputError(f"found {pair!r}", where=f"ranges: {name}", expected="(least, most), in SI units")
    low, high = np.array([[float(a), float(b)] for a, b in ranges.values()]).T
    return low, high


def _si(values: Any) -> Floats:
    """A prediction's outcome in the unit of `MEASURES`."""
    return np.radians(values.values) if values.attrs["units"] == "deg" else values.values


__all__ = ["Limit", "Plan", "optimise_treatment"]
