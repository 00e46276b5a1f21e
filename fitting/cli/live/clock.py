"""How long the page takes to answer."""

from __future__ import annotations

from collections import deque
from statistics import median

KEPT = 50  # times of which median and worst are told


class Clock:
    """The last times, in seconds."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=KEPT)

    def add(self, seconds: float) -> None:
        """Takes note of a time [s]."""
        self._times.append(seconds)

    @property
    def count(self) -> int:
        """How many are kept."""
        return len(self._times)

    def milliseconds(self) -> tuple[float, float, float]:
        """The last, the median and the worst [ms]; NaN before the first."""
        if not self._times:
            return float("nan"), float("nan"), float("nan")
        return 1e3 * self._times[-1], 1e3 * median(self._times), 1e3 * max(self._times)

    def words(self) -> str:
        """In words."""
        if not self._times:
            return "none yet"
        last, middle, worst = self.milliseconds()
        return f"{last:.0f} ms (of the last {self.count}: median {middle:.0f}, worst {worst:.0f} ms)"
