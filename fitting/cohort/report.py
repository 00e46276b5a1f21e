"""What became of a cohort's patients in one run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fitting.cohort.manifest import Failure


@dataclass
class Outcome:
    """Of one patient."""

    patient: str
    status: str = "pending"  # done, failed
    computed: int = 0  # units in this run
    kept: int = 0  # units that were done before
    failure: Failure | None = None


@dataclass
class CohortReport:
    """Of all of them."""

    folder: Path
    outcomes: list[Outcome]
    unwritten: dict[str, str] = field(default_factory=dict)  # why manifest or summary could not be written, at last
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
