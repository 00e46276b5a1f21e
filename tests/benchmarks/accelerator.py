"""Throughput of an accelerator by the size of the batch, and its time by parts.

The study of `tests.benchmarks.batches`, on the first device that JAX has, in processes of their own for double and
single precision; and a batch with mesh contact, which an accelerator is ill suited to. Without an accelerator there is
nothing to measure; the same functions then serve tests on a CPU.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from pftwin.dynamics.batch.batched import Sharding, piece_for
from pftwin.dynamics.batch.member import Task, member_equilibrium, member_motion
from pftwin.dynamics.frame_states import frame_states, substeps_for
from pftwin.model.scene import Scene
from tests.benchmarks.batches import SETTINGS, amounts, transferred
from tests.benchmarks.row import Row

SIZES, QUICK_SIZES = (1_024, 131_072, 1_000_000), (1, 16)
MESH_SIZE = 2_048
REAL_TIME = 1e6  # seconds of motion computed in a second, all variants together
PRECISIONS = ("float64", "float32")
_REPEATS = 3  # repeated runs of a batch; a batch of a million runs once


def has_one() -> bool:
    """Whether JAX's default devices are no CPU."""
    return jax.default_backend() != "cpu"


def rows(scene: Scene, sizes: tuple[int, ...]) -> Iterator[Row]:
    """Throughput by size and shares of the time, in this process' float type, as they are measured."""
    import pftwin

    device = jax.devices()[:1]
    said = f"{device[0].device_kind}, {jnp.zeros(()).dtype}"
    duration = float(scene.motion.frame_interval) * (scene.motion.n_frames - 1)
    for count, estimate in [*((n, True) for n in sizes), (max(sizes), False)]:
        many = pftwin.Variants(scene, transferred, amounts(count))
        study = partial(pftwin.simulate_batch, many, devices=device, estimate=estimate, **SETTINGS)
        cold, found = _clocked(study)
        warm = [_clocked(study)[0] for _ in range(_REPEATS if count < 1_000_000 else 1)]
        seconds = statistics.median(warm)
        details = {"cold_s": cold, "warm_s": warm, "recomputed": found.attrs["recomputed_members"]}
        note = f"{seconds:.3g} s; {said}"
        what = f"{count:,} variants, {jnp.zeros(()).dtype}{'' if estimate else ', without the error of their steps'}"
        yield Row("accelerator", f"{what}: variants a second", count / seconds, "1/s", note=note, details=details)
        target = REAL_TIME if count == max(SIZES) else None
        faster = count * duration / seconds
        yield Row("accelerator", f"{what}: times real time", faster, "times", target, "at least", said)
    yield from _parts(scene, max(sizes), said)


def mesh_row(count: int) -> Row:
    """Throughput of a sphere on a mesh, by the volume of their overlap: 0.25 s of case 1, in steps of 2 ms."""
    import pftwin

    device, scene = jax.devices()[:1], pftwin.rig.case(1, contact="volume")
    scene = replace(scene, motion=replace(scene.motion, n_frames=26))
    many = pftwin.Variants(scene, transferred, amounts(count) / 3)
    study = partial(pftwin.simulate_batch, many, devices=device, **{**SETTINGS, "dt": 2e-3}, estimate=False)
    cold, _ = _clocked(study)
    warm = [_clocked(study)[0] for _ in range(_REPEATS)]
    seconds = statistics.median(warm)
    what = f"{count:,} variants with mesh contact (volume), {jnp.zeros(()).dtype}: times real time"
    duration = float(scene.motion.frame_interval) * (scene.motion.n_frames - 1)
    details = {"cold_s": cold, "warm_s": warm}
    return Row("accelerator", what, count * duration / seconds, "times", note=device[0].device_kind, details=details)


def _clocked(work: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds, and what came out."""
    began = time.perf_counter()
    found = jax.block_until_ready(work())
    return time.perf_counter() - began, found


def _task(scene: Scene) -> Task:
    substeps = jnp.asarray(substeps_for(float(scene.motion.frame_interval), SETTINGS["dt"]))
    return Task(scene, transferred, substeps, SETTINGS["integrator"], SETTINGS["energy_budget"], False, None)


def _stepped(task: Task, row: Any, start: Any) -> Any:
    """The motion alone, of which nothing is looked at but where it ends."""
    path = frame_states(
        task.change(task.scene, row), integrator=task.integrator, substeps=task.substeps, start=start, ledger=False
    )
    return path.states.position.x[-1]


def _parts(scene: Scene, most: int, said: str) -> Iterator[Row]:
    """Of one piece, which is what a device computes at a time: equilibrium, steps, and looking at the frames."""
    device = tuple(jax.devices()[:1])
    piece = piece_for(most, device[0].platform)
    spread, task = Sharding(device, piece, piece), _task(scene)
    shared, chunk = spread.shared(task), next(spread.chunks(min(piece, most)))
    own = spread.placed(amounts(chunk.members), chunk)
    start = spread.run(member_equilibrium, shared, chunk, (own,))
    works: dict[str, Callable[[], Any]] = {
        "equilibrium": lambda: spread.run(member_equilibrium, shared, chunk, (own,)),
        "steps": lambda: spread.run(_stepped, shared, chunk, (own, start)),
        "steps and frames": lambda: spread.run(member_motion, shared, chunk, (own, start)),
    }
    for name, work in works.items():
        _clocked(work)
        seconds = statistics.median(_clocked(work)[0] for _ in range(_REPEATS))
        what = f"{chunk.members:,} side by side, {jnp.zeros(()).dtype}: {name}"
        yield Row("accelerator", what, 1e3 * seconds, "ms", note=said)


def work(task: dict[str, Any], target: Path) -> None:
    """Writes rows as JSON as they are measured: `python -m tests.benchmarks.accelerator TASK TARGET`."""
    import pftwin

    pftwin.configure(float64=task["precision"] == "float64")
    measured: list[dict[str, Any]] = []
    target.write_text("[]", encoding="utf-8")
    if not has_one():
        print("skipped: JAX has no accelerator here; pip install -e '.[cuda]' on a machine that has", file=sys.stderr)
        return
    sizes, meshes = (QUICK_SIZES, QUICK_SIZES[-1]) if task["quick"] else (SIZES, MESH_SIZE)
    for row in chain(rows(pftwin.rig.case(2, contact="P5"), sizes), map(mesh_row, [meshes])):
        measured.append(row.to_json())
        target.write_text(json.dumps(measured), encoding="utf-8")


if __name__ == "__main__":
    work(json.loads(sys.argv[1]), Path(sys.argv[2]))
