"""`simulate_batch`: simulation of many scenes in one batch, over all devices."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batch_dataset import COORDINATES, OWN_NAMES
from pftwin.dynamics.batch.batched import Sharding, piece_for
from pftwin.dynamics.batch.devices import Devices, chosen_devices, feeding_threads
from pftwin.dynamics.batch.member import Outcome, Task, member_equilibrium, member_motion
from pftwin.dynamics.batch.plan import BAD, BAD_BY_DEFAULT, BatchPlan
from pftwin.dynamics.batch.variants import Group, Variants, groups_of
from pftwin.dynamics.frame_states import substeps_for
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.simulate import simulate
from pftwin.dynamics.trajectory import checked_integrator
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset

_PIECES = 8  # default number of pieces per CPU device in a chunk; an accelerator gets one large piece
_LEAST, _FEW, _MOST = 1920, 64, 256  # variants of a part; parts of a batch; pieces of a part
_MOST_FRAMES = 300_000  # total number of frames up to which trajectories are stored by default: 30 MB


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
    """Simulates many scenes (variants) in one batch, each as `simulate` does; failures do not stop other variants.

    Args:
        scenes: a list of scenes; or `Variants`: a scene, a function that changes it, and a row of numbers per variant.
        devices: "all" of JAX's devices, their number, or a list. For more CPU devices, see `configure(cpu_devices=)`.
        chunk: maximum number of variants per transfer of results to the host; at least a piece of 120 variants per
            device. It limits the memory for the results of a chunk, and does not affect the results.
        integrator: as in `simulate`.
        dt: maximum step [s], 1e-3 by default.
        tolerance: instead of `dt`, the accepted error for the first scene of each structure, as in `simulate`; the step
            chosen for that scene applies to all.
        outcome: a pure function of a variant's scene and observation (`pftwin.dynamics.observe.Observation`) that
            returns a dictionary of numbers or arrays to store. Define it once, so that it compiles once.
        trajectories: whether to store paths; by default if all variants together have up to 300,000 frames.
        energy_budget: compute work and heat, from which `ENERGY_FROM_NOWHERE` is flagged.
        estimate: estimate the error of each variant's steps from a second run with twice the step (see
            `pftwin.dynamics.error_estimate`), and flag large errors. It takes half as long again.
        care: recompute variants whose status shows an unreliable run: from a relaxed start, with a quarter of the step,
            with another integrator. Without `dt` and `tolerance`, this includes variants with large estimated errors.
        progress: called with the number of completed variants and of all; with `parts`, of those of this process.
        parts: folder in which results are stored during the computation, one NetCDF file per 1,920 variants or more (or
            per `chunk`). Repeating the call computes only what is missing. Under `jax.distributed` the processes
            divide the variants among themselves; all of them must see the folder.
        share: (k, n) computes only the k-th of n shares, k from 0, and returns its variants: for independent processes,
            e.g. of a job array, that fill one folder `parts` together.

    Returns:
        A dataset over `variant`, in the given order: a summary of each motion, `status`, `status_frames` (number of
        frames with each flag), `recomputed` and `failed`. Variants that remain unreliable are flagged, without an
        error; where `failed` is True, the simulation was impossible and values are NaN.

    Raises:
        InputError: there are no scenes, or an argument or scene is invalid; outcomes differ between scenes, or have
            names of the batch's variables; several processes have no `parts`, or different batches; `parts` contains
            another batch. All of this is checked before the batch is simulated.
        OutputError: a part cannot be written.
        PftwinError: another process failed; the message contains its error.
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
    sharding = _sharding(sum(len(g.places) for g in groups), found_devices, chunk)
    substeps = [_substeps(group, chosen, dt, tolerance) for group in groups]
    tasks = [
        Task(g.scene, g.change, jnp.asarray(n), chosen, bool(energy_budget), courses, outcome, bool(estimate))
        for g, n in zip(groups, substeps, strict=True)
    ]
    _check_outcomes(tasks, [g.rows for g in groups])
    dt_s = max(float(g.scene.motion.frame_interval) / n for g, n in zip(groups, substeps, strict=True))
    settings = {"integrator": chosen.text, "dt_s": dt_s, **({} if tolerance is None else {"tolerance": str(tolerance)})}
    values = scenes.values if isinstance(scenes, Variants) else None
    bad = () if not care else BAD_BY_DEFAULT if dt is None and tolerance is None else BAD
    plan = BatchPlan(groups, tasks, values, settings, bad, sharding, feeding_threads(devices))
    if parts is None:
        return _simulate_whole(plan, progress)
    from pftwin.dynamics.batch.resumable import ResumableBatch

    return ResumableBatch(plan, Path(parts), unit_for(plan.total, sharding.piece, chunk), share, progress).all()


def _sharding(total: int, devices: tuple[Any, ...], chunk: int | None) -> Sharding:
    """How that many variants are divided into pieces for the devices."""
    piece = piece_for(total, devices[0].platform)
    pieces = _PIECES if devices[0].platform == "cpu" else 1
    return Sharding(devices, piece, chunk or pieces * piece * len(devices))


def _simulate_whole(plan: BatchPlan, progress: Callable[[int, int], None] | None) -> Dataset:
    from pftwin.dynamics.batch.batch_dataset import dataset

    found, before = [], 0
    for k, group in enumerate(plan.groups):
        of_all = None if progress is None else (lambda done, _, b=before: progress(b + done, plan.total))
        found.append(plan.found(k, group.rows, of_all))
        before += len(group.places)
    return dataset(plan.groups, found, plan.values, plan.settings)


def unit_for(total: int, piece: int, chunk: int | None = None) -> int:
    """Number of variants per part; it depends on the batch alone, so that any processes and devices can resume it.

    It is a multiple of the piece, and large enough that writing a file takes little time compared with computing.
    """
    if chunk is not None:
        return max(1, chunk // piece) * piece
    return max(-(-_LEAST // piece), min(_MOST, total // piece // _FEW)) * piece


def _check_share(parts: Any, share: Any) -> None:
    """Rejects arguments with which several processes would compute the same variants."""
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
    """Whether to store trajectories."""
    frames = [g.scene.motion.n_frames for g in groups]
    alike = len({(g.scene.motion.n_frames, float(g.scene.motion.frame_interval)) for g in groups}) == 1
    if wanted and not alike:
        raise InputError(
            "scenes of different recorded times", where="trajectories", remedy="a batch for each, or outcomes alone"
        )
    few = sum(n * len(g.places) for n, g in zip(frames, groups, strict=True)) <= _MOST_FRAMES
    return alike and few if wanted is None else bool(wanted)


def _check_outcomes(tasks: Sequence[Task], rows: Sequence[Any]) -> None:
    """Checks, by tracing before anything is simulated, that user-defined outcomes can become variables of the dataset.

    Raises:
        InputError: an outcome is not a dictionary of numbers or arrays, names or shapes differ between groups, or a
            name is one of the batch's own.
    """
    if not tasks or tasks[0].outcome is None:
        return
    found = [_shapes(task, jax.tree.map(lambda a: a[0], some)) for task, some in zip(tasks, rows, strict=True)]
    if any(other != found[0] for other in found):
        raise InputError("found other outcomes in other scenes", where="outcome", expected="the same names and shapes")
    if taken := sorted(OWN_NAMES.union(COORDINATES) & set(found[0])):
        raise InputError(f"found {taken[0]!r}", where="outcome", expected="names that the batch does not have itself")


def _shapes(task: Task, row: Any) -> dict[str, tuple[int, ...]]:
    def own(task: Task, row: Any) -> Any:
        return member_motion(task, row, member_equilibrium(task, row))["own"]

    made = eqx.filter_eval_shape(own, task, row)
    if stray := [n for n, a in made.items() if not (isinstance(n, str) and isinstance(a, jax.ShapeDtypeStruct))]:
        raise InputError(f"found {stray[0]!r}", where="outcome", expected="names with numbers or arrays")
    return {name: a.shape for name, a in made.items()}
