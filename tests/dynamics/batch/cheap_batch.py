"""Batches whose members cost nothing: all of `simulate_batch` runs but for tracing and the motions themselves.

Run as a process of its own it makes the calls it is told, under `jax.distributed`, and prints what came of each.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from batch_checks import bent, bits, rows_of
from elsewhere import surroundings
from small_scene import small_scene

import pftwin
from pftwin.base.errors import OutputError, PftwinError
from pftwin.dynamics.batch import plan, resumable
from pftwin.dynamics.batch.member import FLAGS
from pftwin.dynamics.batch.parts import write_part
from pftwin.dynamics.batch.plan import BatchPlan

COUNT, UNIT = 600, 120  # five parts
LIMIT = 120  # [s] for processes that ought to end by themselves
ENDED_BY_JAX = "another task died"


class Cheap:
    """What replaces the physics, and what it was asked for."""

    def __init__(self) -> None:
        self.rows: list[int] = []  # members of each call
        self.dies_at: int | None = None  # the call at which the process kills itself

    def found(self, plan: BatchPlan, k: int, rows: Any, progress: Any = None) -> dict[str, Any]:
        if self.dies_at == len(self.rows):
            os.kill(os.getpid(), signal.SIGKILL)
        first = rows[0] if isinstance(rows, tuple) else rows
        number = np.asarray(first, float).reshape(len(first), -1)[:, 0]
        self.rows.append(number.size)
        paths = plan.tasks[k].courses
        if progress is not None:
            progress(number.size, number.size)
        return {
            "sensible": number > 0,
            "status_frames": np.stack([number.astype(int) % 3 == i for i in range(len(FLAGS))], axis=1).astype(int),
            "equilibrium_residual": number * 1e-9,
            "start_shift": number * 1e-3,
            "start_turn": number * 1e-2,
            "recomputed": (number.astype(int) % 2).astype(np.int8),
            "summary": {"mean_tilt": np.sin(number), "mean_shift": np.cos(number)},
            "own": {},
            "courses": {"sphere_center": np.tile(np.sin(number)[:, None, None], (1, 6, 3))} if paths else {},
        }


def made_cheap(put: Any = setattr) -> Cheap:
    """Puts it in the place of the physics, by setattr or pytest's `monkeypatch.setattr`."""
    cheap = Cheap()
    put(BatchPlan, "found", lambda plan, k, rows, progress=None: cheap.found(plan, k, rows, progress))
    put(plan, "_program", lambda task, row: "cheap")
    return cheap


def batch(rows: np.ndarray | None = None, **more: Any) -> Any:
    given = rows_of(COUNT) if rows is None else rows
    return pftwin.simulate_batch(
        pftwin.Variants(small_scene(6), bent, given), **{"dt": 5e-3, "chunk": UNIT, "devices": 1, **more}
    )


def digest(data: Any) -> str:
    """Of all variables, to the last bit."""
    return hashlib.sha256(json.dumps(bits(data), sort_keys=True).encode()).hexdigest()


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Ended(NamedTuple):
    """A process that has ended: its status, what it printed, and what it complained of."""

    status: int
    printed: list[dict[str, Any]]
    words: str


def ended(folder: Path, count: int, calls: list[dict[str, Any]], **more: Any) -> list[Ended]:
    """Processes that make these calls, once they have ended; `more` is for `main`."""
    port = free_port()
    tasks = [{"index": i, "count": count, "port": port, "calls": calls, **more} for i in range(count)]
    folder.mkdir()
    return run_together(folder, [[__file__, json.dumps(what)] for what in tasks], LIMIT)


def run_together(
    folder: Path, commands: list[list[str]], limit: float = 600.0, environments: list[dict[str, str]] | None = None
) -> list[Ended]:
    """Python processes at once, until all have ended; what they print goes through files in the folder.

    A pipe that nobody reads would hold one up, and through it the others.
    """
    common = {**surroundings(), "JAX_PLATFORMS": "cpu"}
    processes = [
        subprocess.Popen(
            [sys.executable, *command],
            stdout=(folder / f"{i}.out").open("w"),
            stderr=(folder / f"{i}.err").open("w"),
            env={**common, **(environments[i] if environments else {})},
        )
        for i, command in enumerate(commands)
    ]
    try:
        for process in processes:
            process.wait(limit)
    finally:
        for process in processes:
            process.kill()
    return [
        Ended(process.returncode, _lines(folder / f"{i}.out"), (folder / f"{i}.err").read_text())
        for i, process in enumerate(processes)
    ]


def _lines(printed: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in printed.read_text().splitlines() if line.startswith("{")]


def main(index: int, count: int, port: int, calls: list[dict[str, Any]], recover: bool = False, wait: int = 10) -> None:
    """Makes the calls; each prints a line.

    Args:
        index, count, port: for `jax.distributed`.
        calls: for each its arguments, in which "{index}" in "parts" gives each process its own folder, and what is
            special about it: "seed" has every process draw its own rows, "dies" is who kills itself at which part,
            "full" whose disk is full, "foreign" has the other's device asked for.
        recover: whether the others go on after one was lost.
        wait: for how long a process may be silent [s].
    """
    import warnings

    import jax

    pftwin.configure(cpu_devices=1)
    jax.config.update("jax_enable_recoverability", recover)
    jax.distributed.initialize(
        f"127.0.0.1:{port}", count, index, heartbeat_timeout_seconds=wait, shutdown_timeout_seconds=wait
    )
    cheap = made_cheap()
    resumable.SHOWN = 1.0
    for call in calls:
        call = dict(call)
        cheap.rows.clear()
        rows = rows_of(COUNT) + (index if call.pop("seed", False) else 0)
        cheap.dies_at = call.pop("dies", {}).get(str(index))
        resumable.write_part = _no_room if call.pop("full", None) == index else write_part
        if call.pop("foreign", False):
            call["devices"] = [d for d in jax.devices() if d.process_index != index]
        call |= {"parts": call["parts"].format(index=index)} if "parts" in call else {}
        said: dict[str, Any] = {}
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                said["bits"] = digest(batch(rows, **call))
            except PftwinError as error:
                said |= {"error": str(error), "kind": type(error).__name__}
        said |= {"rows": cheap.rows, "warned": [str(w.message) for w in warned]}
        print(json.dumps(said), flush=True)


def _no_room(folder: Path, *_: Any) -> None:
    raise OutputError(f"{folder}: cannot be written: No space left on device")


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))
