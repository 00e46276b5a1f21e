"""Runs variants singly, or in batches if only parameter values differ, and compares each with the scene's own run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import jax
import numpy as np

from pftwin.base.program_cache import Program
from pftwin.dynamics.batch.variants import groups_of
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.simulate import settle_first_frame
from pftwin.dynamics.status import Status
from pftwin.model.scene import Scene, check
from pftwin.results.metrics import summed
from pftwin.results.result import Result
from pftwin.studies.audit.variants import Variant
from pftwin.studies.runs import Floats, difference, rms


@dataclass(frozen=True, eq=False)
class VariantRun:
    """A variant's result, and a function that runs it again."""

    result: Result
    rerun: Callable[[], Any] | None  # None if it ran in a batch


@Program
def _moving(scene: Scene, start: Solution, integrator: Integrator, substeps: int) -> Observation:
    return observe(scene, frame_states(scene, integrator=integrator, substeps=substeps, start=start))


@Program
def _side_by_side(
    scene: Scene, change: Callable[[Scene, Any], Scene], rows: Any, integrator: Integrator, substeps: int
) -> tuple[Solution, Observation]:
    """Runs a batch of the scenes that `change` makes of the rows."""

    def member(row: Any) -> tuple[Solution, Observation]:
        changed = change(scene, row)
        start = starting_equilibrium(changed)
        return start, observe(changed, frame_states(changed, integrator=integrator, substeps=substeps, start=start))

    return jax.vmap(member)(rows)


def run_alone(scene: Scene, integrator: Integrator, substeps: int) -> VariantRun:
    """Runs one scene from its equilibrium; InputError for an invalid parameter."""
    check(scene)
    unnamed = scene.unnamed()
    start, relaxed = settle_first_frame(unnamed)
    rerun = partial(_moving, unnamed, start.answer, integrator, substeps)
    return VariantRun(_result(scene, start.answer, rerun(), relaxed, integrator, substeps), rerun)


def run_side_by_side(variants: Sequence[Variant], integrator: Integrator, substeps: int) -> list[VariantRun]:
    """Runs variants that differ only in parameter values, each from its equilibrium, in batches of one structure.

    A variant whose search for the equilibrium fails runs again alone. Raises as `run_alone` does.
    """
    runs: list[Any] = [None] * len(variants)
    for group in groups_of([v.scene for v in variants]):
        found = _side_by_side(group.scene, group.change, group.rows, integrator, substeps)
        for k, place in enumerate(group.places):
            scene, (start, observation) = variants[place].scene, jax.tree.map(lambda a, k=k: np.asarray(a)[k], found)
            runs[place] = VariantRun(_result(scene, start, observation, False, integrator, substeps), None)
            if not runs[place].result.equilibrium.converged:  # a single run can also use damped relaxation
                runs[place] = replace(run_alone(scene, integrator, substeps), rerun=None)
    return runs


def _result(scene: Scene, start: Solution, run: Observation, relaxed: bool, integrator: Integrator, n: int) -> Result:
    settings = {"integrator": integrator.text, "dt_s": scene.motion.frame_interval / n, "substeps": n}
    return Result.build(scene, start, run, None, relaxed=relaxed, settings=settings, timing={})


_DEGREES = float(np.degrees(1.0))
LOST = 0.1  # largest plausible distance from the scene's own path [m]


@dataclass(frozen=True)
class Changes:
    """Differences between a variant's run and the scene's own run, over the frames (SI units).

    Each has its column's name, unit, factor and long name. None: a force that either run lacks.
    """

    center_rms: Annotated[float, "path_rms_mm", "mm", 1e3, "distance of the tracked point from its own path, rms"]
    center_max: Annotated[float, "path_max_mm", "mm", 1e3, "distance of the tracked point from its own path, largest"]
    flexion: Annotated[float, "flexion_rms_deg", "deg", _DEGREES, "change of patellar flexion, rms"]
    rotation: Annotated[float, "rotation_rms_deg", "deg", _DEGREES, "change of patellar rotation, rms"]
    tilt: Annotated[float, "tilt_rms_deg", "deg", _DEGREES, "change of patellar tilt, rms"]
    contact_rms: Annotated[float | None, "contact_rms_N", "N", 1, "change of the contact force, rms"]
    contact_max: Annotated[float | None, "contact_max_N", "N", 1, "change of the contact force, largest"]
    tension_rms: Annotated[float | None, "tension_rms_N", "N", 1, "change of the tension that changes most, rms"]
    tension_max: Annotated[float | None, "tension_max_N", "N", 1, "change of that tension, largest"]
    tension_of: str | None  # the effect with that tension


def why_incomparable(result: Result, own: Result) -> str | None:
    """Returns why a run cannot be compared with the scene's run `own`; None if it can."""
    if not result.equilibrium.converged and own.equilibrium.converged:
        return "no equilibrium to start from"
    if Status.NOT_FINITE in result.status:
        return "does not stay finite"
    if np.linalg.norm(result.position - own.position, axis=1).max() > LOST:
        return "the patella flies off"
    return None


def compare_runs(scene: Scene, result: Result, own: Result) -> Changes:
    """Compares a run with the scene's own run."""
    changes = difference(result, own, np.asarray(scene.tracked_point().array(), dtype=np.float64))
    tensions = {
        name: summed(result.effects[name]["tension"]) - summed(report["tension"])
        for name, report in own.effects.items()
        if "tension" in report and "tension" in result.effects.get(name, {})
    }
    most = max(tensions, key=lambda name: rms(tensions[name]), default=None)
    turned = (rms(a) for a in (changes.flexion, changes.rotation, changes.tilt))
    forces = (*_size(changes.contact), *_size(None if most is None else tensions[most]))
    return Changes(rms(changes.center), float(changes.center.max()), *turned, *forces, tension_of=most)


def _size(change: Floats | None) -> tuple[float, float] | tuple[None, None]:
    """Root mean square and largest absolute value of a change."""
    return (None, None) if change is None else (rms(change), float(np.abs(change).max()))
