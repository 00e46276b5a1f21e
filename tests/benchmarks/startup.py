"""The first simulation of a fresh process, without compiled programs from before and with them."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

from pftwin.base.errors import PftwinError
from tests.benchmarks.row import Row

FIRST_CALL = 5.0  # [s]
SECOND_PROCESS = 1.5  # [s]

# What a user's first script does, with a clock beside every line. JAX itself says how long it traced and compiled.
_SCRIPT = """
import json, sys, time
began = time.perf_counter()
import pftwin
pftwin.configure(cache_dir=sys.argv[1] or None)
import jax
spent = {}
def note(event, seconds, **_):
    spent[event.rsplit("/", 1)[-1]] = spent.get(event.rsplit("/", 1)[-1], 0.0) + seconds
jax.monitoring.register_event_duration_secs_listener(note)
imported = time.perf_counter()
scene = pftwin.rig.case(1, contact="P5")
built = time.perf_counter()
pftwin.simulate(scene, dt=float(sys.argv[2]))
simulated = time.perf_counter()
again = time.perf_counter()
pftwin.simulate(scene, dt=float(sys.argv[2]))
print(json.dumps({
    "import_s": imported - began, "scene_s": built - imported, "first_call_s": simulated - built,
    "second_call_s": time.perf_counter() - again,
    "trace_s": spent.get("jaxpr_trace_duration", 0.0), "lower_s": spent.get("jaxpr_to_mlir_module_duration", 0.0),
    "compile_or_load_s": spent.get("backend_compile_duration", 0.0),
}))
"""


def fresh_process(cache: str, dt: float) -> dict[str, Any]:
    """The clock's readings of one fresh process, and its whole wall time less the second call.

    Raises:
        PftwinError: the process failed.
    """
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", _SCRIPT, cache, str(dt)], capture_output=True, text=True, check=False)
    total = time.perf_counter() - began
    if done.returncode:
        raise PftwinError(f"a fresh process ended with code {done.returncode}: {done.stderr.strip()[-500:]}")
    clock = json.loads(done.stdout.splitlines()[-1])
    return {**clock, "total_s": total - clock["second_call_s"]}


def rows(dt: float = 1e-3, repeats: int = 3) -> list[Row]:
    """First call without a cache; whole second process with one."""
    without = [fresh_process("", dt) for _ in range(repeats)]
    with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as cache:
        fresh_process(cache, dt)
        filled = [fresh_process(cache, dt) for _ in range(repeats)]
    cold, warm = _medians(without), _medians(filled)
    return [
        Row("start", "first call of simulate, compiling", cold["first_call_s"], "s", FIRST_CALL, "at most",
            note=_split(cold), details=cold),
        Row("start", "second process, compiled programs kept: all of it", warm["total_s"], "s", SECOND_PROCESS,
            "at most", note=_split(warm), details=warm),
    ]  # fmt: skip


def _medians(clocks: list[dict[str, Any]]) -> dict[str, float]:
    return {key: statistics.median(clock[key] for clock in clocks) for key in clocks[0]}


def _split(c: dict[str, float]) -> str:
    parts = ("import", "scene", "first_call", "trace", "lower", "compile_or_load")
    return ", ".join(f"{p.replace('_', ' ')} {c[f'{p}_s']:.2f} s" for p in parts)
