"""A cohort's progress, the time left, and the outcome of each patient."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from fitting.cohort.manifest import Failure, Unit


class CohortProgress(NamedTuple):
    """Progress of one run, without the units that earlier runs had done."""

    unit: Unit
    share: float  # share of the unit that is done
    ended: bool  # whether its file is written and recorded, or it has failed
    number: int  # of the unit, from 1
    of: int  # units that this run has to do
    seconds: float  # seconds spent on the unit so far
    left: float | None  # for all that is to be done, at the pace so far [s]; None before the first unit has ended
    failure: Failure | None = None


class Pace:
    """Mean times of the units of each kind, since a fit and a prediction take different times."""

    def __init__(self, units: Sequence[Unit]) -> None:
        self.waiting, self.number, self.total = list(units), 0, len(units)
        self.times: dict[str, list[float]] = {}
        self._began = 0.0

    def began(self, unit: Unit) -> None:
        """A unit begins."""
        self.waiting.remove(unit)
        self.number += 1
        self._began = time.perf_counter()

    def progress(self, unit: Unit, share: float) -> CohortProgress:
        """While a unit runs."""
        seconds = time.perf_counter() - self._began
        return self._told(unit, share, seconds, max(self._usual(unit.kind) - seconds, 0.0) if self.times else 0.0)

    def ended(self, unit: Unit, failure: Failure | None) -> CohortProgress:
        """A unit ends. After a failure the patient's other units are not run, and its time is not counted."""
        seconds = time.perf_counter() - self._began
        if failure is None:
            self.times.setdefault(unit.kind, []).append(seconds)
        else:
            self.waiting = [u for u in self.waiting if u.patient != unit.patient]
            self.total = self.number + len(self.waiting)
        return self._told(unit, 1.0, seconds, 0.0)._replace(ended=True, failure=failure)

    def _told(self, unit: Unit, share: float, seconds: float, more: float) -> CohortProgress:
        left = sum(self._usual(u.kind) for u in self.waiting) + more if self.times else None
        return CohortProgress(unit, share, False, self.number, self.total, seconds, left)

    def _usual(self, kind: str) -> float:
        known = self.times.get(kind) or [t for times in self.times.values() for t in times]
        # The first of a kind compiles what the others use: it counts while there is no other.
        steady = known[1:] or known
        return sum(steady) / len(steady)


@dataclass
class Outcome:
    """Of one patient."""

    patient: str
    status: str = "pending"  # done, failed
    computed: int = 0  # units in this run
    kept: int = 0  # units that were done before
    failure: Failure | None = None
    at_bounds: tuple[str, ...] = ()  # fitted parameters that ended at a bound: their true value may lie beyond


@dataclass
class CohortReport:
    """Of all of them."""

    folder: Path
    outcomes: list[Outcome]
    unwritten: dict[str, str] = field(default_factory=dict)  # why manifest or summary could not be written in the end
    seconds: float = 0.0

    @property
    def failed(self) -> list[Outcome]:
        """Patients without all of their results."""
        return [o for o in self.outcomes if o.failure is not None]

    @property
    def sound(self) -> bool:
        """Whether everything is there."""
        return not self.failed and not self.unwritten

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "folder": str(self.folder),
            "seconds": self.seconds,
            "patients": [asdict(o) for o in self.outcomes],
            "unwritten": self.unwritten,
        }
