"""The treatment that was found for stated limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fitting.prediction.outcomes import MEASURES
from fitting.treatments import Treatment
from fitting.treatments.limits import Limit, in_units


@dataclass(frozen=True)
class TreatmentPlan:
    """What was found."""

    met: bool  # whether any amounts within the range meet all limits, in the share of draws that was asked for
    treatment: Treatment  # the smallest that does; where none does, the one that comes nearest
    outcomes: dict[str, float]  # with it, by the estimate, SI
    limits: tuple[Limit, ...]
    simulations: int
    samples: int = 0  # draws from the estimate's uncertainty
    confidence: float = 0.0  # share of them in which all limits were to hold
    share: float | None = None  # in which they do; None without draws

    def describe(self) -> str:
        """In a sentence or two."""
        drawn = ""
        if self.share is not None:
            drawn = (
                f"; all limits hold in {self.share:.0%} of {self.samples} draws from the estimate's uncertainty "
                f"({self.confidence:.0%} asked for)"
            )
        if self.met:
            said = [
                f"{x.outcome.replace('_', ' ')} {in_units(x.outcome, self.outcomes[x.outcome])}" for x in self.limits
            ]
            return f"smallest that meets the limits: {self.treatment.describe()} ({', '.join(said)}){drawn}"
        broken = [lim.describe() for lim in self.limits if not lim.room(self.outcomes[lim.outcome]) >= 0]
        fault = f"which breaks {'; '.join(broken)}" if broken else "which is not sure enough"
        return f"no amount within the range meets the limits; nearest: {self.treatment.describe()}, {fault}{drawn}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; SI units."""
        amounts = zip(self.treatment.names, self.treatment.values, self.treatment.ways, strict=True)
        return {
            "met": self.met,
            "treatment": self.treatment.describe(),
            "amounts": {name: {"value": float(value), "unit": way.unit} for name, value, way in amounts},
            "limits": [
                {
                    "outcome": x.outcome,
                    "at_most": x.at_most,
                    "at_least": x.at_least,
                    "unit": MEASURES[x.outcome].unit,
                    "words": x.describe(),
                    "value": self.outcomes[x.outcome],
                    "holds": bool(x.room(self.outcomes[x.outcome]) >= 0),
                }
                for x in self.limits
            ],
            "outcomes": self.outcomes,
            "units": {name: about.unit for name, about in MEASURES.items()},
            "samples": self.samples,
            "confidence": self.confidence if self.samples else None,
            "share_of_draws": self.share,
            "simulations": self.simulations,
            "sentence": self.describe(),
        }
