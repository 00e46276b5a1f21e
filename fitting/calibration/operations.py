"""Predicts a plant's treatment from an estimate, and compares it with the treated plant."""

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
    """A treatment whose outcomes are predicted; with limits, the smallest one that meets them is searched.

    Args:
        treatment: treatment with its amounts; with limits, the values of amounts that are not in `ranges`.
        limits: limits that the treatment must meet.
        ranges: ranges of the amounts (SI units) to search, as in `optimise_treatment`.
        samples: draws from each estimate.
        confidence: share of the draws that must meet all limits.

    Raises:
        InputError: limits without ranges, ranges without limits, or an invalid one; too few draws; a confidence that is
            no share; several treatments.
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
        """The operation in words."""
        wanted = " and ".join(limit.describe() for limit in self.limits)
        return f"the smallest treatment with {wanted}" if wanted else self.treatment.describe()

    def check(self, scene: Scene) -> None:
        """Checks that a knee can have this operation.

        Raises:
            InputError: the knee lacks the part to treat, or a groove, which outcomes refer to; an amount that the
                treatment does not have.
        """
        Groove.of(scene)
        places_of(self.treatment, self.ranges or ())
        self.treatment(scene)

    def on(self, plant: Scene, recorded: Scene, estimate: Fitted) -> OperationOutcome:
        """Predicts the treatment for the knee as recorded, and simulates it in the plant.

        If this knee cannot have it, there is no plan and no prediction; a plant that cannot be treated as planned is
        not safe. Errors of the caller are raised by `check`.

        Args:
            plant: the plant's scene.
            recorded: the nominal knee in the recorded motion.
            estimate: estimate from the recording.
        """
        treatment, met = self.treatment, None
        try:
            if self.limits:
                options: Any = {"samples": self.samples, "confidence": self.confidence}
                plan = optimise_treatment(recorded, self.limits, self.ranges, treatment, estimate, **options)
                treatment, met = plan.treatment, plan.met
            predicted = predict(recorded, treatment, estimate, samples=self.samples)
        except PftwinError:
            return OperationOutcome(_UNKNOWN, np.zeros((0, len(OUTCOMES))), False if self.limits else None, None, 0.0)
        draws = np.stack([in_si(predicted[name])[0, 1:] for name in OUTCOMES], axis=1)
        run = np.isfinite(draws).all(axis=1)
        try:
            treated = predict(plant, treatment)
        except PftwinError:
            return OperationOutcome(_UNKNOWN, draws[run], met, met and False, float(run.mean()))
        truth = np.array([in_si(treated[name])[0] for name in OUTCOMES])
        safe = met and bool(smallest_margin(treated, self.limits)[0] >= 0)
        return OperationOutcome(truth, draws[run], met, safe, float(run.mean()))


class OperationOutcome(NamedTuple):
    """Outcomes of one plant's treatment, true and predicted."""

    truth: Floats  # (outcomes,)
    draws: Floats  # (M, outcomes), of those that could be simulated
    met: bool | None  # whether a treatment was found that is predicted to meet the limits; None without limits
    safe: bool | None  # whether it meets them in the plant
    share: float = 1.0  # of the draws that could be simulated
