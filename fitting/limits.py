"""Limits that a treatment has to keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fitting.outcomes import MEASURES
from pftwin.errors import InputError

NO_NUMBER = ("dislocation_time", "dislocation_flexion", "re_engagement_time", "re_engagement_flexion")  # where none is
_UNIT_SIZE = {"m": 1e-3, "rad": 0.01, "N": 1.0}  # what room is counted in where the bound is 0


@dataclass(frozen=True)
class Limit:
    """A limit on an outcome, in the outcome's unit (SI).

    Limit("dislocation_margin", at_least=0.003) keeps the button 3 mm from dislocating.
    """

    outcome: str
    at_most: float | None = None
    at_least: float | None = None

    def __post_init__(self) -> None:
        if self.outcome not in MEASURES or self.outcome in NO_NUMBER:
            usable = ", ".join(n for n in MEASURES if n not in NO_NUMBER)
            raise InputError(f"no limit on {self.outcome!r}", where="Limit", expected=f"one of: {usable}")
        bounds = [b for b in (self.at_most, self.at_least) if b is not None]
        if len(bounds) != 1 or not np.isfinite(bounds[0]):
            raise InputError(
                f"found {bounds}", where=f"Limit({self.outcome!r})", expected="either at_most or at_least, a number"
            )

    def room(self, value: Any) -> Any:
        """How far the value is on the right side; negative where the limit is broken."""
        return self.at_most - value if self.at_most is not None else value - self.at_least

    def describe(self) -> str:
        """In words."""
        sense, bound = ("at most", self.at_most) if self.at_most is not None else ("at least", self.at_least)
        about = MEASURES[self.outcome]
        return f"{self.outcome.replace('_', ' ')} {sense} {bound:g} {'' if about.unit == '1' else about.unit}".rstrip()

    @property
    def size(self) -> float:
        """What its room is counted in, so that limits on different outcomes compare."""
        bound = self.at_most if self.at_most is not None else self.at_least
        return abs(float(bound or 0.0)) or _UNIT_SIZE.get(MEASURES[self.outcome].unit, 0.01)
