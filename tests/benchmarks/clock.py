"""Times of compiled functions, cold and warm apart."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Times:
    """Seconds of the first call and of later ones."""

    cold: float
    warm: tuple[float, ...]

    @property
    def median(self) -> float:
        """Of the warm calls [s]."""
        return statistics.median(self.warm)

    def details(self) -> dict[str, Any]:
        """Plain data."""
        return {"cold_s": self.cold, "median_s": self.median, "best_s": min(self.warm), "runs": len(self.warm)}


def measure(call: Callable[[], Any], *, runs: int = 5, seconds: float = 0.5, most: int = 50) -> Times:
    """Times a call that ends when its answer is there: at least `runs` times and for at least `seconds`."""
    import jax

    def once() -> float:
        began = time.perf_counter()
        jax.block_until_ready(call())
        return time.perf_counter() - began

    cold, warm = once(), []
    while len(warm) < runs or (sum(warm) < seconds and len(warm) < most):
        warm.append(once())
    return Times(cold, tuple(warm))


def measure_in_turn(*calls: Callable[[], Any], runs: int = 5, seconds: float = 0.5) -> list[Times]:
    """Times calls whose ratio matters: one of each in turn, so that the machine's other load falls on all alike."""
    import jax

    first = [measure(call, runs=1, seconds=0.0) for call in calls]
    warm: list[list[float]] = [[] for _ in calls]
    while len(warm[0]) < runs or (sum(map(sum, warm)) < seconds * len(calls) and len(warm[0]) < 50):
        for call, times in zip(calls, warm, strict=True):
            began = time.perf_counter()
            jax.block_until_ready(call())
            times.append(time.perf_counter() - began)
    return [Times(f.cold, tuple(w)) for f, w in zip(first, warm, strict=True)]
