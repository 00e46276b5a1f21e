"""One topic in a process of its own: `python -m tests.benchmarks.fitting.worker TASK TARGET`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tests.benchmarks.row import Row

SEEDS = {"efficiency": 25, "methods": 10}
_QUICK_SEEDS = 2


def work(task: dict[str, Any], target: Path) -> None:
    """Measures the task's topic and writes the rows as JSON."""
    import pftwin

    pftwin.configure()
    rows = _measured(task["topic"], task["seeds"], task["quick"])
    target.write_text(json.dumps([row.to_json() for row in rows]), encoding="utf-8")


def _measured(topic: str, seeds: int | None, quick: bool) -> list[Row]:
    if topic == "speed":
        from tests.benchmarks.fitting import speed

        return speed.rows(quick)
    if topic == "plant":
        from tests.benchmarks.fitting import plant

        return plant.rows(quick)
    if topic == "treatments":
        from tests.benchmarks.fitting import treatments

        return treatments.rows(quick)
    count = seeds or (_QUICK_SEEDS if quick else SEEDS[topic])
    if topic == "efficiency":
        from tests.benchmarks.fitting import efficiency

        return efficiency.rows(count)
    from tests.benchmarks.fitting.methods import on_case_2

    return on_case_2.rows(count, quick)


if __name__ == "__main__":
    work(json.loads(sys.argv[1]), Path(sys.argv[2]))
