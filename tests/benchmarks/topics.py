"""What is measured, in which order, and in which process.

Accuracy comes first: it says at which steps speed is worth measuring. Figures per core are taken in processes of their
own, each pinned to one core before JAX starts its threads.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pftwin.base.errors import PftwinError

if TYPE_CHECKING:
    from tests.benchmarks.problem import Setting
    from tests.benchmarks.row import Row

# Topics that need no step of a chosen accuracy.
APART = ("start", "meshes", "growth", "batches", "processes", "scaling", "accelerator")
TOPICS = ("accuracy", "one run", "equilibrium", "batch", "forward", "reverse", *APART)
ON_ONE_CORE = ("batch", "forward", "reverse")
LEVELS = {"0.01": 1e-5, "0.05": 5e-5}  # rms error: as the rows name it in mm, and in metres


def measure_topics(
    chosen: tuple[str, ...], variants: int, quick: bool, say: Callable[[str], None]
) -> Iterator[list[Row]]:
    """The rows of the chosen topics, as each has been measured.

    Raises:
        PftwinError: no step meets an accuracy level; a measuring process failed.
    """
    from tests.benchmarks import accuracy, speed, startup
    from tests.benchmarks.problem import scene_of_case_1

    if set(chosen) - set(APART):
        scene = scene_of_case_1()
        say("measuring accuracy ...")
        found = accuracy.errors(scene, reference=100 if quick else accuracy.REFERENCE)
        if "accuracy" in chosen:
            yield accuracy.rows(scene, found)
        settings = _settings(found)
        for topic in chosen:
            if topic in ("one run", "equilibrium", *ON_ONE_CORE):
                say(f"measuring {topic} ...")
            if topic == "one run":
                yield speed.one_run(scene, settings)
            elif topic == "equilibrium":
                yield speed.equilibrium(scene)
            elif topic in ON_ONE_CORE:
                yield in_a_process({"topic": topic, "settings": settings, "variants": variants, "quick": quick})
    if "start" in chosen:
        say("measuring start ...")
        yield startup.rows(repeats=1 if quick else 3)
    if "meshes" in chosen:
        say("measuring meshes ...")
        from tests.benchmarks import meshes

        yield meshes.rows(20 if quick else 200, whole_motions=not quick)
    if "growth" in chosen:
        say("measuring growth ...")
        from tests.benchmarks import growth

        yield growth.rows(meshes=() if quick else ("volume",))
    if "batches" in chosen:
        say("measuring batches ...")
        yield in_a_process({"topic": "batches", "quick": quick}, "tests.benchmarks.batches")
    if "processes" in chosen:
        say("measuring processes ...")
        from tests.benchmarks import processes

        yield processes.rows(quick)
    if "scaling" in chosen:
        say("measuring scaling ...")
        from tests.benchmarks import scaling

        yield scaling.rows(quick)
    if "accelerator" in chosen:
        say("measuring an accelerator ...")
        from tests.benchmarks.accelerator import PRECISIONS

        for precision in PRECISIONS:
            task = {"topic": "accelerator", "precision": precision, "quick": quick}
            yield in_a_process(task, "tests.benchmarks.accelerator")


def _settings(found: dict[str, Any]) -> dict[str, Setting]:
    """The cheapest that meets each level."""
    from tests.benchmarks.accuracy import cheapest

    settings = {}
    for name, level in LEVELS.items():
        setting = cheapest(found, level)
        if setting is None:
            raise PftwinError(f"no step tried comes within {name} mm of the converged path; try: finer steps")
        settings[name] = setting
    return settings


def in_a_process(task: dict[str, Any], module: str = "tests.benchmarks.worker") -> list[Row]:
    """The rows that a worker writes about a task, measured in a process of its own.

    Args:
        task: what the worker is told, plain data with a "topic".
        module: is run with the task as JSON and the file for its rows.

    Raises:
        PftwinError: the process failed.
    """
    from tests.benchmarks.row import Row

    with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as folder:
        target = Path(folder) / "rows.json"
        command = [sys.executable, "-m", module, json.dumps(task), str(target)]
        if subprocess.run(command, check=False).returncode:
            raise PftwinError(f"the process that measures {task['topic']!r} failed (its message is above)")
        return [Row.from_json(row) for row in json.loads(target.read_text(encoding="utf-8"))]
