"""Limits that a treatment must meet, and the treatment found for them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.coverage import NOT_KNOWN
from fitting.prediction.outcomes import MEASURES
from fitting.treatments import Treatment
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import shown
from pftwin.base.written_amounts import UNITS, number_and_unit

if TYPE_CHECKING:
    from xarray import DataArray, Dataset


NO_NUMBER = ("dislocation_time", "dislocation_flexion", "re_engagement_time", "re_engagement_flexion")  # may be NaN
_WHOLE = ("dislocations", "dislocation_side", "tracks_at_end")  # counts, sides and yes or no: never in %
_UNIT_SIZE = {"m": 1e-3, "rad": 0.01, "N": 1.0}  # scale of the margin if the limit is 0
_WRITTEN = re.compile(r"\s*(\w+)\s*(<=|>=)(.*)")


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
            usable = ", ".join(f"{name} [{units[0] or '-'}]" for name, units, _ in limitable())
            raise InputError(f"no limit on {self.outcome!r}", where="Limit", expected=f"one of: {usable}")
        bounds = [b for b in (self.at_most, self.at_least) if b is not None]
        if len(bounds) != 1 or not np.isfinite(bounds[0]):
            where, expected = f"Limit({self.outcome!r})", "either at_most or at_least, a number"
            raise InputError(f"found {bounds}", where=where, expected=expected)

    @staticmethod
    def parsed(text: str) -> Limit:
        """Parses a text such as "dislocation_margin >= 3 mm": an outcome, a relation, a number and its unit.

        Raises:
            InputError: any other text; a unit that is missing or does not fit the outcome.
        """
        example = 'such as "dislocation_margin>=3 mm" or "peak_contact_force<=40 N"'
        match = _WRITTEN.fullmatch(text)
        written = number_and_unit(match[3]) if match else None
        if match is None or written is None:
            raise InputError(f"found {text!r}", where="limit", expected=example)
        (outcome, sense), (number, unit) = match.groups()[:2], written
        Limit(outcome, at_most=number)  # refuses an outcome that takes no limit
        units = _units_of(outcome)
        if unit not in units:
            expected = f"{outcome} in {' or '.join(u or 'plain numbers' for u in units)}"
            raise InputError(f"found {text!r}", where="limit", expected=expected)
        value = number * units[unit]
        return Limit(outcome, at_most=value) if sense == "<=" else Limit(outcome, at_least=value)

    def room(self, value: Any) -> Any:
        """The margin by which a value meets the limit; negative if it does not."""
        return self.at_most - value if self.at_most is not None else value - self.at_least

    def describe(self) -> str:
        """The limit in words: "dislocation margin at least 3 mm"."""
        sense = "at least" if self.at_most is None else "at most"
        return (
            f"{self.outcome.replace('_', ' ')} {sense} {in_units(self.outcome, self.at_most or self.at_least or 0.0)}"
        )

    @property
    def size(self) -> float:
        """Scale of the margin, so that limits on different outcomes can be compared."""
        return abs(float(self.at_most or self.at_least or 0.0)) or _UNIT_SIZE.get(MEASURES[self.outcome].unit, 0.01)


def limitable() -> list[tuple[str, tuple[str, ...], str]]:
    """Outcomes that can be limited: name, units in which it may be written ("" for a plain number), meaning."""
    numbers = ((name, about) for name, about in MEASURES.items() if name not in NO_NUMBER)
    return [(name, tuple(_units_of(name)), about.long_name) for name, about in numbers]


def _units_of(outcome: str) -> dict[str, float]:
    """Units in which a limit on an outcome may be written, with their sizes in its SI unit."""
    return {"": 1.0} if outcome in _WHOLE else UNITS[MEASURES[outcome].unit]


def smallest_margin(data: Dataset, limits: Sequence[Limit]) -> Floats:
    """Smallest scaled margin over all limits, for every variant (and draw); minus infinity without a value."""
    rooms = np.stack([lim.room(in_si(data[lim.outcome])) / lim.size for lim in limits]).min(axis=0)
    return np.where(np.isfinite(rooms), rooms, -np.inf)


def in_si(values: DataArray) -> Floats:
    """A predicted outcome in the unit of `MEASURES`."""
    return np.radians(values.values) if values.attrs["units"] == "deg" else values.values


def in_units(outcome: str, value: float) -> str:
    """An outcome's value in the units shown to readers: lengths in mm, angles in degrees."""
    return shown(value, MEASURES[outcome].unit, 4)


@dataclass(frozen=True)
class TreatmentPlan:
    """The result of an optimisation."""

    met: bool  # whether any amounts within the range meet all limits, in the required share of draws
    treatment: Treatment  # the smallest that meets the limits; if none does, the one that comes nearest
    outcomes: dict[str, float]  # outcomes with it, for the estimate, SI units
    limits: tuple[Limit, ...]
    simulations: int
    samples: int = 0  # draws from the estimate's uncertainty
    confidence: float = 0.0  # required share of draws that meet all limits
    share: float | None = None  # share of draws that meet them; None without draws
    invalid: str = ""  # "INVALID" and why, if the estimate is, or no amount has a valid motion
    interrupted: bool = False  # whether Ctrl-C ended the search: this is the best so far
    coverage: str = NOT_KNOWN.plans  # measured share of such plans that are safe, in words
    trust: Mapping[str, Any] = field(default_factory=dict)  # "status" and "status_frames", for a single amount

    def describe(self) -> str:
        """The plan in a sentence or two."""
        if self.invalid:
            return self.invalid
        drawn = ""
        if self.share is not None:
            drawn = (
                f"; all limits are met in {self.share:.0%} of {self.samples} draws from the estimate's uncertainty "
                f"({self.confidence:.0%} required); {self.coverage}"
            )
        smallest = "interrupted; the smallest so far" if self.interrupted else "smallest"
        if self.met:
            reached = {x.outcome: in_units(x.outcome, self.outcomes[x.outcome]) for x in self.limits}
            said = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in reached.items())
            return f"{smallest} that meets the limits: {self.treatment.describe()} ({said}){drawn}"
        broken = [lim.describe() for lim in self.limits if not lim.room(self.outcomes[lim.outcome]) >= 0]
        few = self.share is not None and self.share < self.confidence - 1e-9
        fault = "which meets the limits in too few draws" if few else "which meets the limits, but was not confirmed"
        fault = f"which breaks {'; '.join(broken)}" if broken else fault
        if self.interrupted:
            return f"interrupted; the best so far: {self.treatment.describe()}, {fault}{drawn}"
        return f"no amount within the range meets the limits; nearest: {self.treatment.describe()}, {fault}{drawn}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; SI units."""
        amounts = zip(self.treatment.names, self.treatment.values, self.treatment.ways, strict=True)
        return {
            "met": self.met,
            "verdict": self.invalid or "valid",
            "interrupted": self.interrupted,
            **self.trust,
            "treatment": self.treatment.describe(),
            "amounts": {name: {"value": float(value), "unit": way.unit} for name, value, way in amounts},
            "limits": [
                {
                    **asdict(x),
                    "unit": MEASURES[x.outcome].unit,
                    "words": x.describe(),
                    "value": self.outcomes[x.outcome],
                    "holds": not self.invalid and bool(x.room(self.outcomes[x.outcome]) >= 0),
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
