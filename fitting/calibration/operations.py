"""What is predicted of a plant's treatment from an estimate, beside what the treated plant does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fitting.prediction.outcomes import Groove
from fitting.prediction.predicting import Fitted, predict
from fitting.treatments import Treatment
from fitting.treatments.limits import Limit, in_si, smallest_margin
from fitting.treatments.optimise import check_confidence, check_limits, check_ranges, optimise_treatment
from fitting.treatments.refine import places_of
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinError
from pftwin.model.scene import Scene

OUTCOMES = (
    "mean_tilt",
    "mean_shift",
    "largest_lateral_offset",
    "mean_contact_force",
    "peak_contact_force",
    "lateral_share",
)
_UNKNOWN = np.full(len(OUTCOMES), np.nan)


@dataclass(frozen=True)
class Operation:
    """A treatment whose outcomes are predicted; or, with limits, the smallest that is found to meet them.

    Args:
        treatment: with its amounts; with limits, their values where `ranges` does not name them.
        limits: that a treatment is to meet.
        ranges: of the amounts (SI) in which it is looked for, as `optimise_treatment` has them.
        samples: draws from each estimate.
        confidence: share of them in which all limits are to hold.

    Raises:
        InputError: limits without ranges, ranges without limits, or one of them that is none; too few draws; a
            confidence that is no share; several treatments.
    """

    treatment: Treatment
    limits: tuple[Limit, ...] = ()
    ranges: Mapping[str, tuple[float, float]] | None = None
    samples: int = 100
    confidence: float = 0.9

    def __post_init__(self) -> None:
        if bool(self.limits) != bool(self.ranges):
            expected = "limits with the ranges in which to look for a treatment, or neither"
            raise InputError("found one of them", where="operation", expected=expected)
        if not isinstance(self.samples, int) or self.samples < 20:
            raise InputError(f"found {self.samples!r}", where="samples", expected="a whole number, at least 20")
        check_confidence(self.confidence)
        if any(np.ndim(value) for value in self.treatment.values):
            raise InputError("found several amounts", where="treatment", expected="one treatment")
        if self.ranges:
            check_limits(self.limits)
            check_ranges(self.ranges)

    def describe(self) -> str:
        """In words."""
        wanted = " and ".join(limit.describe() for limit in self.limits)
        return f"the smallest treatment with {wanted}" if wanted else self.treatment.describe()

    def check(self, scene: Scene) -> None:
        """Refuses what this knee cannot have.

        Raises:
            InputError: a treatment of a part that it lacks; an amount that the treatment does not know; no groove, from
                which outcomes are told.
        """
        Groove.of(scene)
        places_of(self.treatment, self.ranges or ())
        self.treatment(scene)

    def on(self, plant: Scene, recorded: Scene, estimate: Fitted) -> Operated:
        """What is predicted for a knee as it was recorded, and what the plant does.

        What this knee cannot have is no plan and no prediction; a plant that cannot be treated as planned is not safe.
        What the caller got wrong is told by `check`.

        Args:
            plant: the knee itself.
            recorded: the nominal knee in the recorded motion.
            estimate: from the recording.
        """
        treatment, met = self.treatment, None
        try:
            if self.limits:
                options: Any = {"samples": self.samples, "confidence": self.confidence}
                plan = optimise_treatment(recorded, self.limits, self.ranges, treatment, estimate, **options)
                treatment, met = plan.treatment, plan.met
            told = predict(recorded, treatment, estimate, samples=self.samples)
        except PftwinError:
            return Operated(_UNKNOWN, np.zeros((0, len(OUTCOMES))), False if self.limits else None, None, 0.0)
        draws = np.stack([in_si(told[name])[0, 1:] for name in OUTCOMES], axis=1)
        run = np.isfinite(draws).all(axis=1)
        try:
            done = predict(plant, treatment)
        except PftwinError:
            return Operated(_UNKNOWN, draws[run], met, met and False, float(run.mean()))
        truth = np.array([in_si(done[name])[0] for name in OUTCOMES])
        safe = met and bool(smallest_margin(done, self.limits)[0] >= 0)
        return Operated(truth, draws[run], met, safe, float(run.mean()))


class Operated(NamedTuple):
    """Of one plant."""

    truth: Floats  # (outcomes,)
    draws: Floats  # (M, outcomes), those that can be simulated
    met: bool | None  # whether a treatment was found that is predicted to meet the limits; None without any
    safe: bool | None  # whether it then does in the plant
    share: float = 1.0  # of the draws that can be simulated
