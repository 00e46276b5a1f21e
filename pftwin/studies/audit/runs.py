"""Runs of variants: those of another structure one by one, those that differ in numbers only side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.program_cache import Program
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.simulate import settle
from pftwin.model.scene import Scene, check
from pftwin.results.result import Result
from pftwin.studies.audit.variant import Variant

Leaves = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class VariantRun:
    """A variant's result, and a way to run it once more."""

    result: Result
    again: Callable[[], Any] | None  # None where it ran side by side with others


@Program
def _moving(scene: Scene, start: Solution, integrator: Integrator, substeps: int) -> Observation:
    return observe(scene, frame_states(scene, integrator=integrator, substeps=substeps, start=start))


@Program
def _side_by_side(
    scene: Scene, places: tuple[int, ...], values: Leaves, integrator: Integrator, substeps: int
) -> tuple[Solution, Observation]:
    """Members whose leaves at these places have these values, along a leading axis."""
    leaves, structure = jax.tree.flatten(scene)

    def member(values: Leaves) -> tuple[Solution, Observation]:
        own = list(leaves)
        for place, value in zip(places, values, strict=True):
            own[place] = value
        changed = jax.tree.unflatten(structure, own)
        start = starting_equilibrium(changed)
        return start, observe(changed, frame_states(changed, integrator=integrator, substeps=substeps, start=start))

    return jax.vmap(member)(values)


def run_alone(scene: Scene, integrator: Integrator, substeps: int) -> VariantRun:
    """One scene, from its own equilibrium.

    Raises:
        InputError: a parameter that cannot give a right answer.
    """
    check(scene)
    plain = scene.unnamed()
    start, relaxed = settle(plain)
    again = partial(_moving, plain, start.answer, integrator, substeps)
    return VariantRun(_result(scene, start.answer, again(), relaxed, integrator, substeps), again)


def run_side_by_side(
    base: Scene, variants: Sequence[Variant], integrator: Integrator, substeps: int
) -> list[VariantRun]:
    """Variants of the base in numbers only, each from its own equilibrium, in one program.

    One whose search fails runs alone once more, by the base's program.

    Raises:
        InputError: a parameter that cannot give a right answer.
    """
    for v in variants:
        check(v.scene)
    own = jax.tree.leaves(base.unnamed())
    members = [jax.tree.leaves(v.scene.unnamed()) for v in variants]
    places = tuple(i for i, leaf in enumerate(own) if any(m[i] is not leaf for m in members))
    values = tuple(jnp.stack([jnp.asarray(m[i]) for m in members]) for i in places)
    starts, seen = _side_by_side(base.unnamed(), places, values, integrator, substeps)
    runs = []
    for k, v in enumerate(variants):
        start, observed = jax.tree.map(lambda a, k=k: np.asarray(a)[k], (starts, seen))
        run = VariantRun(_result(v.scene, start, observed, False, integrator, substeps), None)
        if not run.result.equilibrium.converged:  # alone, the damped relaxation helps
            run = replace(run_alone(v.scene, integrator, substeps), again=None)
        runs.append(run)
    return runs


def _result(scene: Scene, start: Solution, seen: Observation, relaxed: bool, integrator: Integrator, n: int) -> Result:
    settings = {"integrator": integrator.text, "dt_s": scene.motion.frame_interval / n, "substeps": n}
    return Result.build(scene, start, seen, None, relaxed=relaxed, settings=settings, timing={})
