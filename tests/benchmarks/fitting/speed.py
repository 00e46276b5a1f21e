"""How long fits of case 2 take, warm and cold, and how much memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tests.benchmarks.clock import Times, measure
from tests.benchmarks.row import Row
from tests.benchmarks.topics import in_a_process

if TYPE_CHECKING:
    from fitting.estimate import Estimate

DEFAULT_FIT = 2.0  # [s] warm
COLD_FIT = 40.0  # [s] in a process that has to compile
GENETIC_FIT = 10.0  # [s] warm
MATLAB: dict[str, Any] = {
    "population": 50,
    "generations": 400,
}  # what `ga` takes by default for four bounded parameters


def rows(quick: bool) -> list[Row]:
    """The default fit with both objectives, and the genetic one."""
    import pftwin

    scene, measured = pftwin.rig.case(2), pftwin.rig.measured(2)
    out = []
    for objective in ("paper", "likelihood"):
        what = f"default fit of K1, L1, K2, L2, 32 starts, objective {objective}, warm"
        out.append(_row(what, DEFAULT_FIT, _default(scene, measured, objective), 2 if quick else 7))
    out.append(cold())
    budget: dict[str, Any] = {"population": 10, "generations": 3} if quick else MATLAB
    what = f"fit by matlab_ga, population {budget['population']}, at most {budget['generations']} generations, warm"
    out.append(_row(what, GENETIC_FIT, _genetic(scene, measured, budget), 1 if quick else 3))
    return out


def _default(scene: Any, measured: Any, objective: str) -> Callable[[], Estimate]:
    import fitting

    return lambda: fitting.fit_tendons(scene, measured, objective=objective)


def _genetic(scene: Any, measured: Any, budget: dict[str, Any]) -> Callable[[], Estimate]:
    import fitting

    return lambda: fitting.fit_tendons(scene, measured, objective="paper", method="matlab_ga", **budget)


def _row(what: str, target: float, fit: Callable[[], Estimate], runs: int) -> Row:
    from fitting.demo.paper_study import PAPER
    from tests.benchmarks.fitting.memory import peak

    cpu: list[float] = []
    found: list[Estimate] = []

    def once() -> float:
        began = time.process_time()
        found.append(fit())
        cpu.append(time.process_time() - began)
        return found[-1].objective_value

    times: Times = measure(once, runs=runs, seconds=0.0)
    last, spent = found[-1], sorted(cpu[1:])[len(cpu[1:]) // 2]
    note = f"{last.evaluations:,} evaluations, {spent:.2f} s of processor time; {last.reason}"
    note += f"; paper {PAPER.seconds:,.0f} s"
    details = {**times.details(), "cpu_s": spent, "evaluations": last.evaluations, "memory_MiB": peak()}
    return Row("speed", what, times.median, "s", target, "at most", note, details)


def cold() -> Row:
    """The whole of a fresh process that fits once, with nothing kept from before."""
    kept = {name: os.environ.pop(name) for name in ("JAX_COMPILATION_CACHE_DIR",) if name in os.environ}
    began = time.perf_counter()
    try:
        inner = in_a_process({"topic": "one fit in a fresh process"}, "tests.benchmarks.fitting.cold_fit")[0]
    finally:
        os.environ.update(kept)
    total = time.perf_counter() - began
    d = inner.details
    memory = "" if d["memory_MiB"] is None else f", at most {d['memory_MiB']:,.0f} MiB"
    note = f"import {d['import_s']:.2f} s, scene {d['scene_s']:.2f} s, fit {d['fit_s']:.1f} s{memory}"
    what = "default fit, objective paper, cold: a whole process without a cache"
    return Row("speed", what, total, "s", COLD_FIT, "at most", note, d)
