"""One topic on one core: `python -m tests.benchmarks.worker TASK TARGET`, started by `tests.benchmarks.topics`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

COUNTS = {"0.01": (64,), "0.05": (1, 16, 64, 256)}  # variants side by side, by accuracy level [mm]


def pin_to_one_core() -> str:
    """Keeps this process on one core, if JAX has not started its threads; returns what was done."""
    if not hasattr(os, "sched_setaffinity"):
        return "not pinned: this system cannot"
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    return "pinned to one core"


def work(task: dict[str, Any], target: Path) -> None:
    """Measures the task's topic and writes the rows as JSON."""
    pinned = pin_to_one_core()
    import pftwin

    pftwin.configure()
    from tests.benchmarks import derivatives, speed
    from tests.benchmarks.problem import Setting, scene_of_case_1

    scene, settings = scene_of_case_1(), {level: Setting(*given) for level, given in task["settings"].items()}
    if task["topic"] == "batch":
        rows = speed.batch(scene, settings, min(task["variants"], 16) if task["quick"] else task["variants"])
    elif task["topic"] == "forward":
        rows = derivatives.forward(
            scene, settings, {level: (4,) if task["quick"] else COUNTS[level] for level in settings}
        )
    else:
        rows = derivatives.reverse(scene, settings)
    for row in rows:
        row.details["cores"] = pinned
    target.write_text(json.dumps([row.to_json() for row in rows]), encoding="utf-8")


if __name__ == "__main__":
    work(json.loads(sys.argv[1]), Path(sys.argv[2]))
