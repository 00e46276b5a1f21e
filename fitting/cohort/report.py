"""A cohort's progress, the time left, and each patient's outcome."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from fitting.cohort.manifest import Failure, Unit


class CohortProgress(NamedTuple):
    """Progress of one run, without the units that earlier runs completed."""

    unit: Unit
    share: float  # share of the unit that is done
    ended: bool  # whether its file is written and recorded, or it has failed
    number: int  # number of the unit in this run, from 1
    of: int  # number of units in this run
    seconds: float  # time spent on the unit so far [s]
    left: float | None  # time left for all units at the pace so far [s]; None before the first unit has ended
    failure: Failure | None = None


class Pace:
    """Mean times of the units of each kind, since a fit and a prediction take different times."""

    def __init__(self, units: Sequence[Unit]) -> None:
        self.waiting, self.number, self.total = list(units), 0, len(units)
        self.times: dict[str, list[float]] = {}
        self._began = 0.0

    def began(self, unit: Unit) -> None:
        """Records the start of a unit."""
        self.waiting.remove(unit)
        self.number += 1
        self._began = time.perf_counter()

    def progress(self, unit: Unit, share: float) -> CohortProgress:
        """Progress while a unit runs."""
        seconds = time.perf_counter() - self._began
        more = max(self._mean_time(unit.kind) - seconds, 0.0) if self.times else 0.0
        return self._progress(unit, share, seconds, more)

    def ended(self, unit: Unit, failure: Failure | None) -> CohortProgress:
        """Records the end of a unit. After a failure the patient's other units are skipped and its time not counted."""
        seconds = time.perf_counter() - self._began
        if failure is None:
            self.times.setdefault(unit.kind, []).append(seconds)
        else:
            self.waiting = [u for u in self.waiting if u.patient != unit.patient]
            self.total = self.number + len(self.waiting)
        return self._progress(unit, 1.0, seconds, 0.0)._replace(ended=True, failure=failure)

    def _progress(self, unit: Unit, share: float, seconds: float, more: float) -> CohortProgress:
        left = sum(self._mean_time(u.kind) for u in self.waiting) + more if self.times else None
        return CohortProgress(unit, share, False, self.number, self.total, seconds, left)

    def _mean_time(self, kind: str) -> float:
        known = self.times.get(kind) or [t for times in self.times.values() for t in times]
        # The first unit of a kind includes compilation: it counts only until there is another.
        steady = known[1:] or known
        return sum(steady) / len(steady)


@dataclass
class PatientOutcome:
    """Outcome of one patient."""

    patient: str
    status: str = "pending"  # done, failed
    computed: int = 0  # units in this run
    kept: int = 0  # units completed by earlier runs
    failure: Failure | None = None
    at_bounds: tuple[str, ...] = ()  # fitted parameters that ended at a bound: their true value may lie beyond


@dataclass
class CohortReport:
    """Outcomes of all patients."""

    folder: Path
    outcomes: list[PatientOutcome]
    unwritten: dict[str, str] = field(default_factory=dict)  # why the manifest or summary could not be written
    seconds: float = 0.0

    @property
    def failed(self) -> list[PatientOutcome]:
        """Patients without all of their results."""
        return [o for o in self.outcomes if o.failure is not None]

    @property
    def sound(self) -> bool:
        """Whether all results are complete and written."""
        return not self.failed and not self.unwritten

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "folder": str(self.folder),
            "seconds": self.seconds,
            "patients": [asdict(o) for o in self.outcomes],
            "unwritten": self.unwritten,
        }
