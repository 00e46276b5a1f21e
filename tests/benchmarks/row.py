"""One measured figure beside its target."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Sense = Literal["at least", "at most"]


@dataclass(frozen=True)
class Row:
    """A figure, its unit, and where there is one its target."""

    topic: str
    what: str
    value: float
    unit: str
    target: float | None = None
    sense: Sense = "at least"
    note: str = ""
    details: dict[str, Any] = field(default_factory=dict)  # cold and warm times and whatever explains the figure

    @property
    def passed(self) -> bool | None:
        """Whether the target is met; None where there is none. A value that is not a number meets no target."""
        if self.target is None:
            return None
        return self.value >= self.target if self.sense == "at least" else self.value <= self.target

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**asdict(self), "passed": self.passed}

    @staticmethod
    def from_json(data: dict[str, Any]) -> Row:
        """From `to_json`'s answer."""
        return Row(**{k: v for k, v in data.items() if k != "passed"})
