"""Batches of hard cases: stacked scenes, starting states, runs, and a check that these do not depend on their batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Vec3
from pftwin.dynamics.equilibrium import Solution, converged_on_host, place_unknown
from pftwin.dynamics.error_estimate import Course
from pftwin.dynamics.frame_states import relaxed_start, substeps_for
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.relaxation import ended_far_away
from pftwin.dynamics.status import Status
from pftwin.dynamics.tolerance import Choice, Tried, accurate_enough, with_estimate
from pftwin.dynamics.trajectory import DEFAULT_STEP
from pftwin.model.scene import Scene, check
from pftwin.studies.hard_cases import derivatives
from pftwin.studies.hard_cases.case import CaseIntegrator, HardCase
from pftwin.studies.hard_cases.knee import RATE
from pftwin.studies.hard_cases.programs import (
    OPTIONS,
    PARAMETERS,
    CaseRun,
    Rest,
    compiled,
    equilibrium_with_derivatives,
    poses,
    run,
)


class CaseBatch(NamedTuple):
    """Cases of one structure, stacked along the leading axis of every array."""

    cases: tuple[HardCase, ...]
    scenes: Scene

    def only(self, which: list[int]) -> CaseBatch:
        """Returns the batch of some cases, given their indices."""
        return CaseBatch(tuple(self.cases[k] for k in which), members(self.scenes, which))


def built_scene(case: HardCase, contact: str) -> Scene:
    """Builds and checks the scene of a case; InputError if it is rejected."""
    scene = case.builder().scene_on(contact, case.name)
    check(scene)
    return scene


def batches(cases: Sequence[HardCase], contact: str) -> tuple[list[CaseBatch], dict[str, InputError]]:
    """Returns batches of the cases with a kind of contact, one per group, and the errors of rejected cases by name."""
    groups: dict[str, list[tuple[HardCase, Scene]]] = {}
    refused: dict[str, InputError] = {}
    for case in cases:
        if contact not in case.contacts:
            continue
        try:
            scene = built_scene(case, contact).unnamed()
        except InputError as error:
            refused[case.name] = error
        else:
            groups.setdefault(case.group, []).append((case, scene))
    return [CaseBatch(tuple(c for c, _ in g), stacked([s for _, s in g])) for g in groups.values()], refused


def stacked(trees: Sequence[Any]) -> Any:
    """Stacks pytrees of one structure along a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(x) for x in leaves]), *trees)


def member(tree: Any, k: int) -> Any:
    """Returns one member of a stacked pytree, on the host."""
    return jax.tree.map(lambda a: np.asarray(a)[k], tree)


def members(tree: Any, which: list[int]) -> Any:
    """Returns some members of a stacked pytree, stacked."""
    at = np.asarray(which)
    return jax.tree.map(lambda a: a[at], tree)


def steps_of(case: HardCase, method: CaseIntegrator) -> int:
    """Returns the number of steps per frame; for a method that chooses its steps, the first to try."""
    step = DEFAULT_STEP if method.chooses_steps else min(case.step, method.longest_step)
    return substeps_for(1 / RATE, step)


def short_enough(batch: CaseBatch, method: CaseIntegrator) -> list[int]:
    """Returns the indices of a batch's cases that do not exceed the method's limit of steps."""
    frames, most = batch.scenes.motion.n_frames - 1, method.most_steps
    return [k for k, c in enumerate(batch.cases) if most is None or frames * steps_of(c, method) <= most]


LARGEST = 2000  # most steps of the compared runs: in one batch all take as many as the longest
AGREE = {"float64": 1e-10, "float32": 1e-4}  # tolerance of poses between batches [m, quaternion components]


def batch_faults(batch: CaseBatch, starts: Any, substeps: Any, method: CaseIntegrator, dtype: str) -> dict[str, str]:
    """Checks that no result depends on the rest of its batch; returns the faults by case.

    All cases run in one batch (`jax.vmap`) in reversed order, first with every second one set to NaN and then with the
    others. The remaining results must equal those of the unchanged batch in the original order.
    """
    if not method.side_by_side:
        return {}
    n = len(batch.cases)
    program = jax.jit(jax.vmap(partial(run, integrator=method.integrator)), compiler_options=OPTIONS)
    frames = batch.scenes.motion.n_frames - 1
    steps = jnp.minimum(substeps, max(1, LARGEST // frames))
    args = (batch.scenes, starts, steps, jnp.zeros((n, 4)))
    alone = np.asarray(poses(program(*args).states))
    back = np.arange(n)[::-1]
    scenes, *others = jax.tree.map(lambda a: a[jnp.asarray(back)], args)
    # Integers, such as indices of a mesh, stay unchanged.
    nowhere = jax.tree.map(lambda a: jnp.full_like(a, jnp.nan) if eqx.is_inexact_array(a) else a, scenes)
    said: dict[str, str] = {}
    for parity in (0, 1):
        spoiled = _select_members(back % 2 == parity, nowhere, scenes)
        mixed = np.asarray(poses(program(spoiled, *others).states))[back]
        for k, case in enumerate(batch.cases):
            if k % 2 == parity:
                continue
            same = (mixed[k] == alone[k]) | (np.isnan(mixed[k]) & np.isnan(alone[k]))  # infinite numbers too
            off = np.abs(np.subtract(mixed[k], alone[k], where=~same, out=np.zeros(same.shape))).max()
            if not off <= AGREE[dtype]:
                said[case.name] = f"depends on its batch: {off:.1g} off"
    return said


@jax.vmap
def _in_patella_frame(pose: Pose, center: Vec3) -> Pose:
    """Poses of the patella from poses of its centre of mass."""
    return Pose(pose.apply(-center), pose.orientation)


class Starts(NamedTuple):
    """Starting states of the cases of a batch."""

    chosen: Solution
    wrong: dict[str, str]  # faults of the equilibria, by case


def starts_of(batch: CaseBatch, dtype: str) -> Starts:
    """Finds the equilibria of all cases and their derivatives, with damped relaxation if the search fails."""
    double, n = dtype == "float64", len(batch.cases)
    search, nothing = compiled(equilibrium_with_derivatives, double), jnp.zeros((n, len(PARAMETERS)))
    found: Rest = search(batch.scenes, nothing)
    scenes, wanted = batch.scenes, np.array([not c.released for c in batch.cases])
    lost = ~converged_on_host(found.equilibrium) & wanted  # a patella released from its start pose keeps that pose
    if lost.any():
        there = compiled(relaxed_start, double)(scenes)
        usable = lost & ~ended_far_away(scenes.start, there)
        scenes = eqx.tree_at(lambda s: s.start, scenes, _select_members(usable, there, scenes.start))
        retried: Rest = search(scenes, nothing)
        found = _select_members(lost & converged_on_host(retried.equilibrium), retried, found)
    chosen = _select_members(~wanted, found.released, found.equilibrium)
    return Starts(chosen, _failing_equilibria(batch, found, scenes, search, dtype))


def _select_members(which: Any, a: Any, b: Any) -> Any:
    """Selects stacked members from `a` where `which` is True, otherwise from `b`."""
    return jax.vmap(lambda chosen, x, y: jax.tree.map(partial(jnp.where, chosen), x, y))(jnp.asarray(which), a, b)


def _failing_equilibria(batch: CaseBatch, found: Rest, scenes: Any, search: Any, dtype: str) -> dict[str, str]:
    """Faults of the derivatives of the equilibria: not finite, or different from finite differences."""
    at = _in_patella_frame(found.equilibrium.pose, scenes.patella.center_of_mass)
    n, near = len(batch.cases), eqx.tree_at(lambda s: s.start, scenes, at)
    said, columns = {}, np.asarray(found.slopes)
    at_rest = converged_on_host(found.equilibrium)
    # A failed search is flagged in every frame, so it needs no check here.
    checked = [k for k, case in enumerate(batch.cases) if not case.released and at_rest[k]]
    smooth = [k for k in checked if batch.cases[k].expected.smooth and dtype == "float64"]
    reference: dict[int, np.ndarray] = {}
    if smooth:

        def changed(p: Any) -> Any:
            return poses(search(near, jnp.tile(jnp.asarray(p), (n, 1)), only=smooth).equilibrium.pose)

        reference = dict(zip(smooth, derivatives.differences(changed), strict=True))
    for k in checked:
        words = derivatives.not_finite(columns[k][None], np.array([True]))
        if words is None and k in reference:
            words = derivatives.disagree(columns[k], reference[k], dtype)
        if words is not None:
            said[batch.cases[k].name] = f"equilibrium: {words}"
    return said


SAME_PLACE = 2e-4  # equilibria farther apart than this are different ones [m, quaternion components]


def other_equilibria(batch: CaseBatch, double: Solution, single: Solution) -> tuple[list[int], Solution]:
    """Finds cases that start in another equilibrium in float32, with the one that a float64 search finds there.

    A button of flat triangles can rest on several of them, and rounding decides on which. A case whose float32 start is
    no equilibrium in float64 is not among them: its start is wrong. Float64 must be enabled. Takes the stacked
    equilibria in both float types; returns indices and stacked equilibria.
    """
    ours, theirs = (np.asarray(poses(found.pose), float) for found in (double, single))
    at_rest, distance = converged_on_host(double) & converged_on_host(single), np.abs(ours - theirs).max(axis=1)
    which = [k for k, c in enumerate(batch.cases) if not c.released and at_rest[k] and distance[k] > SAME_PLACE]
    if not which:
        return [], double
    pose = jax.tree.map(lambda a: jnp.asarray(a, float), single.pose)
    scenes = eqx.tree_at(lambda s: s.start, batch.scenes, _in_patella_frame(pose, batch.scenes.patella.center_of_mass))
    nothing = jnp.zeros((len(batch.cases), len(PARAMETERS)))
    near: Solution = compiled(equilibrium_with_derivatives, True)(scenes, nothing, only=which).equilibrium
    off = np.abs(np.asarray(poses(near.pose)) - theirs[which]).max(axis=1)
    confirmed = np.flatnonzero(converged_on_host(near) & (off <= SAME_PLACE)).tolist()
    return [which[i] for i in confirmed], members(near, confirmed)


class BatchRuns:
    """Runs of a batch's cases with any number of steps, by one compiled program; each run is cached."""

    def __init__(self, batch: CaseBatch, starts: Any, integrator: Integrator, float64: bool) -> None:
        """Prepares the program; makes no run yet."""
        self._program = compiled(run, float64, integrator=integrator)
        self._batch, self._starts = batch, starts
        self._runs: dict[tuple[int, int], CaseRun] = {}

    def with_parameters(self, substeps: Sequence[int], p: Any, only: Sequence[int]) -> CaseRun:
        """Runs the cases `only` with parameters changed by p (4,); returns stacked runs."""
        n = len(self._batch.cases)
        steps, changes = np.asarray(substeps, int), np.tile(np.asarray(p), (n, 1))
        return self._program(self._batch.scenes, self._starts, jnp.asarray(steps), jnp.asarray(changes), only=only)

    def tried(self, k: int, n: int) -> Tried[CaseRun]:
        """Returns the run of case k with n steps per frame."""
        if (k, n) not in self._runs:
            ran = self.with_parameters([n] * len(self._batch.cases), np.zeros(len(PARAMETERS)), [k])
            self._runs[k, n] = member(ran, 0)
        found = self._runs[k, n]
        too_long = (found.observation.status & int(Status.STEP_TOO_LONG)).any()
        return Tried(found, Course.of(found.observation, "contact"), not too_long)

    def chosen(self, substeps: Sequence[int], method: CaseIntegrator) -> list[Choice[CaseRun]]:
        """Returns runs with these steps, or with those that `pftwin.simulate` chooses from there, with error flags."""
        choose = accurate_enough if method.chooses_steps else with_estimate
        found = []
        for k, n in enumerate(substeps):
            choice = choose(partial(self.tried, k), n, method.integrator.order)
            error = choice.error.with_start(place_unknown(member(self._starts, k)))
            status = choice.run.observation.status | error.flags
            flagged = eqx.tree_at(lambda r: r.observation.status, choice.run, status)
            found.append(replace(choice, run=flagged, error=error))
        return found
