"""Limits that a treatment has to keep."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from fitting.prediction.outcomes import MEASURES
from pftwin.base.errors import InputError

NO_NUMBER = ("dislocation_time", "dislocation_flexion", "re_engagement_time", "re_engagement_flexion")  # where none is
_UNIT_SIZE = {"m": 1e-3, "rad": 0.01, "N": 1.0}  # what room is counted in where the bound is 0
_UNITS = {  # in which people write limits, by the unit of the outcome
    "m": {"mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "rad": {"deg": np.pi / 180, "rad": 1.0},
    "N": {"N": 1.0},
    "1": {"": 1.0, "%": 0.01},
}
_WRITTEN = re.compile(r"\s*(\w+)\s*(<=|>=)\s*([-+.\deE]+)\s*([A-Za-z%]*)\s*")


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

    @staticmethod
    def parsed(text: str) -> Limit:
        """From "dislocation_margin >= 3 mm": an outcome, a sense, a number and its unit.

        Raises:
            InputError: anything else; a unit that is missing or is not the outcome's.
        """
        example = 'such as "dislocation_margin>=3 mm" or "peak_contact_force<=40 N"'
        match = _WRITTEN.fullmatch(text)
        try:
            number = float(match[3]) if match else np.nan
        except ValueError:
            number = np.nan
        if match is None or not np.isfinite(number):
            raise InputError(f"found {text!r}", where="limit", expected=example)
        outcome, sense, _, unit = match.groups()
        limit = Limit(outcome, at_most=number) if sense == "<=" else Limit(outcome, at_least=number)
        units = _UNITS[MEASURES[outcome].unit]
        if unit not in units:
            raise InputError(
                f"found {text!r}",
                where="limit",
                expected=f"{outcome} in {' or '.join(u or 'plain numbers' for u in units)}",
            )
        value = number * units[unit]
        return Limit(limit.outcome, value if sense == "<=" else None, value if sense == ">=" else None)

    def room(self, value: Any) -> Any:
        """How far the value is on the right side; negative where the limit is broken."""
        return self.at_most - value if self.at_most is not None else value - self.at_least

    def describe(self) -> str:
        """In words: "dislocation margin at least 3 mm"."""
        sense, bound = ("at most", self.at_most) if self.at_most is not None else ("at least", self.at_least)
        return f"{self.outcome.replace('_', ' ')} {sense} {in_units(self.outcome, bound or 0.0)}"

    @property
    def size(self) -> float:
        """What its room is counted in, so that limits on different outcomes compare."""
        bound = self.at_most if self.at_most is not None else self.at_least
        return abs(float(bound or 0.0)) or _UNIT_SIZE.get(MEASURES[self.outcome].unit, 0.01)


def in_units(outcome: str, value: float) -> str:
    """An outcome's value as people read it: lengths in mm, angles in degrees."""
    unit, scale = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "1": ("", 1.0)}.get(
        MEASURES[outcome].unit, (MEASURES[outcome].unit, 1.0)
    )
    return f"{scale * value:.4g} {unit}".rstrip()
