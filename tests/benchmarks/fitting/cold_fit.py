"""One fit in a fresh process that keeps nothing: `python -m tests.benchmarks.fitting.cold_fit TASK TARGET`."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

_BEGAN = time.perf_counter()


def work(target: Path) -> None:
    """Fits case 2 by the paper's objective with a clock beside every line, and writes one row as JSON."""
    import pftwin

    pftwin.configure()
    import fitting
    from tests.benchmarks.fitting.memory import peak
    from tests.benchmarks.row import Row

    imported = time.perf_counter()
    scene, measured = pftwin.rig.case(2), pftwin.rig.measured(2)
    built = time.perf_counter()
    fitting.fit_tendons(scene, measured, objective="paper")
    fitted = time.perf_counter()
    details = {
        "import_s": imported - _BEGAN,
        "scene_s": built - imported,
        "fit_s": fitted - built,
        "memory_MiB": peak(),
        "cpu_s": time.process_time(),
    }
    row = Row("speed", "one fit in a fresh process", fitted - _BEGAN, "s", details=details)
    target.write_text(json.dumps([row.to_json()]), encoding="utf-8")


if __name__ == "__main__":
    work(Path(sys.argv[2]))
