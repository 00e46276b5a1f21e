"""`simulate_batch`: many scenes at once, over all devices."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.devices import Devices, chosen_devices, feeding_threads
from pftwin.dynamics.batch.member import Outcome, Task
from pftwin.dynamics.batch.plan import BatchPlan, check_outcomes
from pftwin.dynamics.batch.retry import BAD, BAD_BY_DEFAULT
from pftwin.dynamics.batch.sharding import Sharding, piece_for
from pftwin.dynamics.batch.variants import Group, Variants, groups_of
from pftwin.dynamics.frame_states import substeps_for
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.simulate import simulate
from pftwin.dynamics.trajectory import checked_integrator
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset

_PIECES = 8  # of each CPU device in a chunk, by default; a piece of an accelerator is large by itself
_LEAST, _FEW, _MOST = 1920, 64, 256  # members of a part; parts of a batch; pieces of a part
_MOST_FRAMES = 300_000  # of all members, up to which trajectories are kept without being asked for: 30 MB


def simulate_batch(
    scenes: Sequence[Scene] | Variants,
    *,
    devices: Devices = "all",
    chunk: int | None = None,
    integrator: Integrator | None = None,
    dt: float | None = None,
    tolerance: str | float | None = None,
    outcome: Outcome | None = None,
    trajectories: bool | None = None,
    energy_budget: bool = True,
    estimate: bool = True,
    care: bool = True,
    progress: Callable[[int, int], None] | None = None,
    parts: str | os.PathLike[str] | None = None,
    share: tuple[int, int] | None = None,
) -> Dataset:
    """Many simulations side by side. Each is what `simulate` gives of its scene; none that fails stops the others.

    Args:
        scenes: a list of scenes; or `Variants`: a scene, a function that changes it, and a row of numbers a member.
        devices: "all" that JAX has, a number of them, or a list. How to have more of a CPU: `configure(cpu_devices=)`.
        chunk: most members between two looks of the host; at least a piece of 120 members for each device. It bounds
            the memory for what is kept of a chunk, and does not change the answer.
        integrator: as in `simulate`.
        dt: longest step [s], 1e-3 by default.
        tolerance: instead of `dt`, how far off the path of the first scene of each structure may be: the step that
            `simulate` chooses for it serves all.
        outcome: a pure function of a member's scene and its observation (`pftwin.dynamics.observe.Observation`), to a
            dictionary of numbers or arrays: they are kept as well. A function that is defined once compiles once.
        trajectories: whether paths are kept; by default where all members together have up to 300,000 frames.
        energy_budget: keep account of work and heat, by which energy from nowhere is found.
        estimate: tell the error of each member's steps from a second run in twice the step (see
            `pftwin.dynamics.error_estimate`) and flag where it is large. It takes half as long again.
        care: recompute members whose status says that the run is not to be trusted: from a relaxed start, by steps of a
            quarter, by another integrator. Without `dt` and `tolerance` those whose estimated error is large as well.
        progress: called with the number of members done and of all; with `parts`, of those that this process computes.
        parts: a folder in which members are kept as they are computed, a NetCDF file for each 1,920 of them or more (or
            for each `chunk`). The same call again computes only what is missing there. Under `jax.distributed` the
            processes share the members out; the folder has to be one that all of them see.
        share: (k, n) computes the k-th of n shares alone, k from 0, and returns its members: for processes that know
            nothing of each other, such as a job array's. Together they fill one folder of `parts`.

    Returns:
        A dataset over `variant`, in the order given: a summary of each motion, `status`, `status_frames` (frames with
        each flag), `recomputed` and `failed`. Nothing is raised for members that stay bad: they are marked, and hold
        NaN where `failed` says that they could not be simulated at all.

    Raises:
        InputError: no scenes, or something that is none; a scene that cannot give a right answer; a step, integrator,
            chunk or number of devices that makes no sense; outcomes that differ between scenes, or are named as what a
            batch has by itself; several processes without `parts`, or with different batches; parts of another batch.
            All of it before anything is simulated.
        OutputError: a part that cannot be written.
        PftwinError: another process failed, with its words.
    """
    found_devices = chosen_devices(devices)
    if chunk is not None and (not isinstance(chunk, int) or isinstance(chunk, bool) or chunk < 1):
        raise InputError(f"found {chunk!r}", where="chunk", expected="a whole number, at least 1")
    if dt is not None and tolerance is not None:
        raise InputError("found both dt and tolerance", where="simulate_batch", expected="one of them")
    _check_share(parts, share)
    groups = groups_of(scenes)
    chosen = checked_integrator(integrator or BDF2(), "simulate_batch")
    for group in groups:
        chosen.refuse_unfit(group.scene.effects)
    courses = _with_courses(groups, trajectories)
    total = sum(len(g.places) for g in groups)
    piece = piece_for(total, found_devices[0].platform)
    pieces = _PIECES if found_devices[0].platform == "cpu" else 1
    spread = Sharding(found_devices, piece, chunk or pieces * piece * len(found_devices))
    threads = feeding_threads(devices)
    substeps = [_substeps(group, chosen, dt, tolerance) for group in groups]
    tasks = [
        Task(g.scene, g.change, jnp.asarray(n), chosen, bool(energy_budget), courses, outcome, bool(estimate))
        for g, n in zip(groups, substeps, strict=True)
    ]
    check_outcomes(tasks, [g.rows for g in groups])
    dt_s = max(float(g.scene.motion.frame_interval) / n for g, n in zip(groups, substeps, strict=True))
    settings = {"integrator": chosen.text, "dt_s": dt_s, **({} if tolerance is None else {"tolerance": str(tolerance)})}
    values = scenes.values if isinstance(scenes, Variants) else None
    bad = () if not care else BAD_BY_DEFAULT if dt is None and tolerance is None else BAD
    plan = BatchPlan(groups, tasks, values, settings, bad, spread, threads)
    if parts is None:
        return _simulate_whole(plan, progress)
    from pftwin.dynamics.batch.resumable import InParts

    return InParts(plan, Path(parts), unit_for(total, piece, chunk), share, progress).all()


def _simulate_whole(plan: BatchPlan, progress: Callable[[int, int], None] | None) -> Dataset:
    from pftwin.dynamics.batch.batch_dataset import dataset

    found, before = [], 0
    for k, group in enumerate(plan.groups):
        told = None if progress is None else (lambda done, _, b=before: progress(b + done, plan.total))
        found.append(plan.found(k, group.rows, told))
        before += len(group.places)
    return dataset(plan.groups, found, plan.values, plan.settings)


def unit_for(total: int, piece: int, chunk: int | None = None) -> int:
    """Members of a part: by the batch alone, so that any number of processes and devices can go on with it.

    Whole pieces; so many members that writing a file is little beside computing them, and not many files.
    """
    if chunk is not None:
        return max(1, chunk // piece) * piece
    return max(-(-_LEAST // piece), min(_MOST, total // piece // _FEW)) * piece


def _check_share(parts: Any, share: Any) -> None:
    """Refuses what would compute everything several times over."""
    processes = jax.process_count()
    if processes > 1 and parts is None:
        raise InputError(
            f"{processes} JAX processes, and no folder in which each could put its part",
            where="simulate_batch",
            expected="parts= with a folder that all of them see",
        )
    if share is None:
        return
    numbers = isinstance(share, Sequence) and len(share) == 2 and all(type(n) is int for n in share)
    if not numbers or not 0 <= share[0] < share[1]:
        raise InputError(f"found {share!r}", where="share", expected="(k, n) with k of 0 to n - 1, such as (0, 4)")
    if parts is None:
        raise InputError("no folder to share", where="share", expected="parts= with a folder")
    if processes > 1:
        raise InputError(f"{processes} JAX processes share by themselves", where="share", remedy="leave it out")


def _substeps(group: Group, integrator: Integrator, dt: float | None, tolerance: str | float | None) -> int:
    if tolerance is None:
        return substeps_for(group.scene.motion.frame_interval, 1e-3 if dt is None else dt)
    first = simulate(group.scene, integrator=integrator, tolerance=tolerance)
    return int(first.settings["substeps"])


def _with_courses(groups: list[Group], wanted: bool | None) -> bool:
    """Whether trajectories are kept."""
    frames = [g.scene.motion.n_frames for g in groups]
    alike = len({(g.scene.motion.n_frames, float(g.scene.motion.frame_interval)) for g in groups}) == 1
    if wanted and not alike:
        raise InputError(
            "scenes of different recorded times", where="trajectories", remedy="a batch for each, or outcomes alone"
        )
    few = sum(n * len(g.places) for n, g in zip(frames, groups, strict=True)) <= _MOST_FRAMES
    return alike and few if wanted is None else bool(wanted)
