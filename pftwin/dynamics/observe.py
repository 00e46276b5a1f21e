"""Observables of a motion: poses in the femur frame, reports of the effects, energies, and a status per frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import FrameStates, scan_observations
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.packing import map_rows
from pftwin.dynamics.state import Guide, State, System
from pftwin.dynamics.status import status_of_all, status_of_frame, status_of_lines
from pftwin.model.effects.base import Instant
from pftwin.model.scene import Scene


class Observation(eqx.Module):
    """Observables at the recorded frames (leading axis n), or at one frame, without what needs the whole motion."""

    patella: Pose  # patella frame in the femur frame
    center: Vec3  # centre of the button (without contact, the patella's origin) in the femur frame [m]
    effects: dict[str, dict[str, Array]]
    kinetic_energy: Scalar  # [J]
    potential_energy: dict[str, Scalar]  # by name, for effects that store energy [J]
    status: Array  # (n,) int, bits of `Status`
    drift: Array | None = None  # (n,) largest constraint violation so far, if the integrator has constraints [m]


def observe(scene: Scene, path: FrameStates) -> Observation:
    """Observables at every recorded frame. Supports jit and vmap."""
    look, guides = _frame_observer(scene, path.integrator)
    diagnostics = path.integrator.diagnostics(path.states)
    # A loop compiles as fast as a single frame.
    observation = map_rows(lambda at: look(at[0], at[1], path.step), (path.states, guides))
    energies = None
    if path.ledger is not None:
        energies = observation.kinetic_energy, observation.potential_energy, path.ledger.work
    flags = status_of_all(observation.status, path.start, energies, path.step, diagnostics.snaps)
    return replace(observation, status=flags, drift=diagnostics.drift)


def observe_during_run(
    scene: Scene,
    select: Callable[[Observation], Any],
    *,
    integrator: Integrator = LinearImplicit(),
    substeps: int | Scalar = 10,
    start: Solution | None = None,
    ledger: bool = False,
) -> tuple[Any, Array, Solution]:
    """Simulates and stores only what `select` returns from the observation of each frame, which halves a batch's time.

    A pure function. See `frame_states` for the other arguments.

    Returns:
        The values of `select` (n_frames, ...), the status (n_frames,), and the initial equilibrium.
    """
    look, guides = _frame_observer(scene, integrator)
    step = scene.motion.frame_interval / jnp.maximum(substeps, 1).astype(float)

    def at(state: State, books: Ledger | None, index: Scalar) -> tuple[Any, Array, Any, Any]:
        observation = look(state, jax.tree.map(lambda a: a[index], guides), step)
        energies = None if books is None else (observation.kinetic_energy, observation.potential_energy, books.work)
        return select(observation), observation.status, energies, integrator.diagnostics(state).snaps

    (found, status, energies, snaps), start, step = scan_observations(
        scene, at, integrator=integrator, substeps=substeps, start=start, ledger=ledger
    )
    return found, status_of_all(status, start, energies, step, snaps), start


def instant_and_frame(scene: Scene, state: State, guide: Guide) -> tuple[Instant, Pose, Vec3]:
    """The instant for effects, the pose of the patella frame in the femur frame, and the tracked point there [m]."""
    now, turn = guide.instant(state.patella(), 0.0), state.orientation
    origin = now.femur.to_local(state.position - turn.rotate(scene.patella.center_of_mass))
    femur_to_world = Quaternion.identity() if guide.femur is None else Quaternion.from_rotation(guide.femur.rotation)
    relative = femur_to_world.conjugate() * turn
    return now, Pose(origin, relative), origin + relative.rotate(scene.tracked_point())


def tracked_center(scene: Scene, states: State) -> Vec3:
    """Centre of the button (without contact, the patella's origin) in the femur frame at the recorded frames [m].

    Computes none of the other observables.
    """
    center = states.position + states.orientation.rotate(scene.tracked_point() - scene.patella.center_of_mass)
    femur = scene.motion.femur
    return center if femur is None else femur.frames(scene.motion.frame_times()).to_local(center)


def _frame_observer(scene: Scene, chosen: Integrator) -> tuple[Callable[[State, Guide, Scalar], Observation], Guide]:
    """A function from (state, guided bodies, step) to observables of a frame; and the guided bodies at all frames."""
    system = System.of(scene)
    # Exact frame times, so that rounding does not move the last frame beyond the last knot.
    times = scene.motion.frame_times()

    def look(state: State, guide: Guide, step: Scalar) -> Observation:
        now, patella, center = instant_and_frame(scene, state, guide)
        found = {e.name: e.report(now, m) for e, m in zip(system.effects, state.memories, strict=True)}
        reports = {name: report for name, (report, _) in found.items()}
        stored = {name: energy for name, (_, energy) in found.items() if energy is not None}
        status = status_of_frame(scene, reports, state, step, chosen.diagnostics(state).residual)
        status = status | status_of_lines(system, now)
        kinetic = system.kinetic_energy(state) if chosen.inertia else jnp.zeros_like(step)
        return Observation(patella, center, reports, kinetic, stored, status)

    return look, Guide.sample(scene.motion, times)
