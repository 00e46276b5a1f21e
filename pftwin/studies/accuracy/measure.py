"""Errors and run times of programs at several steps, against the converged run of the same contact model."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.simulate import settle_first_frame
from pftwin.dynamics.status import status_facts
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene
from pftwin.results.metrics import Validation, validate
from pftwin.results.result import Result
from pftwin.studies.accuracy.programs import (
    MESHES,
    REFERENCE,
    REFERENCE_ON_MESHES,
    VARIANTS,
    MeasuredProgram,
    Programs,
    programs,
)
from pftwin.studies.runs import Difference, difference, rms, run_each, time_in_turn

SceneOf = Callable[[str], Scene]  # makes a scene from a contact's name, in JAX's current default float type
GRADIENT_SUBSTEPS = 2


@dataclass(frozen=True)
class AccuracyRow:
    """A row of the table, with units and long names of its columns. NaN: not measured or not applicable."""

    contact: str
    integrator: str
    order: Annotated[int, "1", "order that the integrator declares"]
    dtype: str
    step_ms: Annotated[float, "ms", "step"]
    position_rms_mm: Annotated[
        float, "mm", "button's centre against the converged run of the same contact, rms over the frames"
    ]
    position_max_mm: Annotated[float, "mm", "the same, largest"]
    tilt_rms_deg: Annotated[float, "deg", "tilt against the converged run, rms"]
    force_rms_n: Annotated[float, "N", "contact force against the converged run, rms"]
    dislocation_ms: Annotated[float, "ms", "time of the first dislocation, less the converged run's"]
    measured_mm: Annotated[float, "mm", "mean distance of the button's centre from the measurements"]
    real_time: Annotated[float, "1", "one run with all results, in times faster than real time"]  # without equilibrium
    real_time_batch: Annotated[float, "1", "64 variants side by side, in times faster than real time"]
    compile_s: Annotated[float, "s", "tracing and compiling one run"]
    gradient: Annotated[float, "1", "a run with four forward derivatives, in plain runs"]
    status: str
    status_frames: dict[str, int] = field(default_factory=dict)  # number of frames with each flag; not in the tables


@dataclass(frozen=True)
class Converged:
    """The converged reference run of a contact model."""

    result: Result
    doubt_mm: float  # rms distance from the converged run of a second integrator


@contextlib.contextmanager
def compiling_anew() -> Iterator[None]:
    """Context without JAX's compilation cache, so that compile times are those of a first run."""
    from jax.experimental.compilation_cache import compilation_cache

    cache_dir = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_compilation_cache_dir", cache_dir)
        compilation_cache.reset_cache()


def converged(scene: Scene, contact: str) -> Converged:
    """Computes the float64 reference run with Newmark's method (BDF2 on meshes), checked by a second integrator."""
    mesh = contact in MESHES
    names = ("linear_implicit_bdf2", "linear_implicit") if mesh else ("newmark", "linear_implicit_bdf2")
    start, relaxed = settle_first_frame(scene.unnamed())
    found = []
    for name in names:
        p = programs(scene, name)
        observation = jax.jit(p.one)(p.arrays, start.answer, jnp.asarray(REFERENCE_ON_MESHES if mesh else REFERENCE))
        found.append(_result(scene, start.answer, relaxed, observation))
    return Converged(found[0], 1e3 * rms(_difference(scene, found[1], found[0]).center))


def rows(setting: MeasuredProgram, scene: Scene, reference: Converged, measured: Measured | None) -> list[AccuracyRow]:
    """Measures one setting; returns a row for each step, all from one compiled program."""
    start, relaxed = settle_first_frame(scene.unnamed())
    p = programs(scene, setting.integrator)
    steps = {n: jnp.asarray(n) for n in setting.substeps}
    began = time.perf_counter()
    one = jax.jit(p.one).lower(p.arrays, start.answer, steps[setting.substeps[0]]).compile()
    compiling = time.perf_counter() - began
    times = _times(one, p, start.answer, steps)
    batch = _times(jax.jit(p.many), p, start.answer, steps) if setting.batch else {}
    gradient = math.nan
    if setting.gradient:
        at = steps.get(GRADIENT_SUBSTEPS, steps[setting.substeps[0]])
        pair = [partial(jax.jit(program), p.arrays, start.answer, at) for program in (p.path, p.columns)]
        gradient = time_in_turn(pair, rounds=5, seconds=0.2, own=False)[1].ratio
    order = integrator_from_text(setting.integrator).order

    def row(n: int, at: Any) -> AccuracyRow:
        result = _result(scene, start.answer, relaxed, one(p.arrays, start.answer, at))
        distance = None if measured is None else validate(result, measured, tibial=None, femoral=None).mean_distance
        return AccuracyRow(
            setting.contact,
            setting.integrator,
            order,
            setting.dtype,
            1e3 * scene.motion.frame_interval / n,
            **_errors(scene, result, reference.result),
            measured_mm=math.nan if distance is None else distance,
            real_time=result.duration / times[n],
            real_time_batch=VARIANTS * result.duration / batch[n] if batch else math.nan,
            compile_s=compiling,
            gradient=gradient,
            **status_facts(result.flags),
        )

    return [row(n, at) for n, at in steps.items()]


def _times(program: Callable[..., Any], p: Programs, start: Any, steps: dict[int, Any]) -> dict[int, float]:
    """Run times by number of steps per frame [s]."""
    runs = {n: partial(program, p.arrays, start, at) for n, at in steps.items()}
    return {n: time_in_turn([run], rounds=3, seconds=0.2, own=False)[0].seconds for n, run in runs.items()}


def _result(scene: Scene, start: Any, relaxed: bool, observation: Any) -> Result:
    return Result.build(scene, start, observation, None, relaxed=relaxed, settings={}, timing={})


def _difference(scene: Scene, found: Result, reference: Result) -> Difference:
    return difference(found, reference, np.asarray(scene.tracked_point().array(), dtype=np.float64))


def _errors(scene: Scene, found: Result, reference: Result) -> dict[str, float]:
    off = _difference(scene, found, reference)
    return {
        "position_rms_mm": 1e3 * rms(off.center),
        "position_max_mm": 1e3 * float(np.max(off.center)),
        "tilt_rms_deg": float(np.degrees(rms(off.tilt))),
        "force_rms_n": math.nan if off.contact is None else rms(off.contact),
        "dislocation_ms": 1e3 * (_dislocation(found) - _dislocation(reference)),
    }


def _dislocation(result: Result) -> float:
    """Time of the first dislocation [s]; NaN if there is none."""
    outcome = result.dislocations() if np.isfinite(result.center).all() else None
    return outcome.events[0].time if outcome is not None and outcome.events else math.nan


@dataclass(frozen=True)
class AccuracyMeasured:
    """Results of an accuracy study."""

    rows: list[AccuracyRow]
    references: dict[str, Converged]  # converged runs by contact
    models: dict[str, Validation]  # errors of the converged runs by contact; empty without measurements


def measure_all(
    plan: Sequence[MeasuredProgram],
    scene_of: SceneOf,
    measured: Measured | None,
    tell: Callable[[str], None],
    keep: Callable[[list[AccuracyRow]], Any] = lambda _: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> AccuracyMeasured:
    """Measures all settings of a plan, each against the converged run of its contact and optional measurements.

    `tell` is called with a message before each piece of work, `progress` with the number of settings done and their
    total, and `keep` with all rows so far after each setting, to store them.
    """
    references: dict[str, Converged] = {}

    def before(k: int, setting: MeasuredProgram) -> None:
        progress(k, len(plan))
        if setting.contact not in references:
            tell(f"{setting.contact}: converged run")
            with jax.enable_x64(True):
                references[setting.contact] = converged(scene_of(setting.contact), setting.contact)
        tell(f"{k + 1} of {len(plan)}: {setting.contact}, {setting.integrator}, {setting.dtype}")

    def one(setting: MeasuredProgram) -> list[AccuracyRow]:
        with jax.enable_x64(setting.dtype == "float64"):
            return rows(setting, scene_of(setting.contact), references[setting.contact], measured)

    with compiling_anew():
        found = run_each(plan, one, before=before, after=lambda pieces: keep([r for p in pieces for r in p]))
    if len(found) < len(plan):
        raise KeyboardInterrupt  # `keep` has the measured rows
    models = {} if measured is None else {c: _against(r, measured) for c, r in references.items()}
    return AccuracyMeasured([row for piece in found for row in piece], references, models)


def _against(reference: Converged, measured: Measured) -> Validation:
    tibial, femoral = (n if n in reference.result.effects else None for n in ("patellar_tendon", "quadriceps"))
    return validate(reference.result, measured, tibial=tibial, femoral=femoral)
