"""Observables of a motion: poses in the femur's frame, what each effect reports, energies, and a status per frame."""

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
    """Arrays over the recorded frames (leading axis n), or those of one frame, without what needs the whole motion."""

    patella: Pose  # patella frame in the femur's
    center: Vec3  # the button's sphere centre (else the patella's origin) in the femur's frame [m]
    effects: dict[str, dict[str, Array]]
    kinetic_energy: Scalar  # [J]
    potential_energy: dict[str, Scalar]  # stored by each effect that stores any [J]
    status: Array  # (n,) int, bits of `Status`
    drift: Array | None = None  # (n,) largest violation of a constraint so far, where the integrator has any [m]


def observe(scene: Scene, path: FrameStates) -> Observation:
    """The observables of every recorded frame. Pure: jit and vmap apply."""
    look, guides = _frame_observer(scene, path.integrator)
    told = path.integrator.diagnostics(path.states)
    # A loop compiles as quickly as a single frame.
    seen = map_rows(lambda at: look(at[0], at[1], path.step), (path.states, guides))
    energies = None
    if path.ledger is not None:
        energies = seen.kinetic_energy, seen.potential_energy, path.ledger.work
    flags = status_of_all(seen.status, path.start, energies, path.step, told.snaps)
    return replace(seen, status=flags, drift=told.drift)


def observe_on_the_way(
    scene: Scene,
    kept: Callable[[Observation], Any],
    *,
    integrator: Integrator = LinearImplicit(),
    substeps: int | Scalar = 10,
    start: Solution | None = None,
    ledger: bool = False,
) -> tuple[Any, Array, Solution]:
    """Simulates and keeps what `kept` selects of a frame's observation. Pure; it halves the time of a batch.

    Options as in `frame_states`.

    Returns:
        What is kept (n_frames, ...), the status (n_frames,), and the equilibrium at the start.
    """
    look, guides = _frame_observer(scene, integrator)
    step = scene.motion.frame_interval / jnp.maximum(substeps, 1).astype(float)

    def at(state: State, books: Ledger | None, index: Scalar) -> tuple[Any, Array, Any, Any]:
        seen = look(state, jax.tree.map(lambda a: a[index], guides), step)
        energies = None if books is None else (seen.kinetic_energy, seen.potential_energy, books.work)
        return kept(seen), seen.status, energies, integrator.diagnostics(state).snaps

    (found, status, energies, snaps), start, step = scan_observations(
        scene, at, integrator=integrator, substeps=substeps, start=start, ledger=ledger
    )
    return found, status_of_all(status, start, energies, step, snaps), start


def instant_and_frame(scene: Scene, state: State, guide: Guide) -> tuple[Instant, Pose, Vec3]:
    """The instant that effects take, the patella's frame in the femur's, and the tracked point there [m]."""
    now, turn = guide.instant(state.patella(), 0.0), state.orientation
    origin = now.femur.to_local(state.position - turn.rotate(scene.patella.center_of_mass))
    femur_to_world = Quaternion.identity() if guide.femur is None else Quaternion.from_rotation(guide.femur.rotation)
    relative = femur_to_world.conjugate() * turn
    return now, Pose(origin, relative), origin + relative.rotate(scene.tracked_point())


def tracked_center(scene: Scene, states: State) -> Vec3:
    """The button's centre (without a contact: the patella's origin) in the femur's frame, at the recorded frames [m].

    Nothing else of what `observe` returns is computed.
    """
    center = states.position + states.orientation.rotate(scene.tracked_point() - scene.patella.center_of_mass)
    femur = scene.motion.femur
    return center if femur is None else femur.frames(scene.motion.frame_times()).to_local(center)


def _frame_observer(scene: Scene, chosen: Integrator) -> tuple[Callable[[State, Guide, Scalar], Observation], Guide]:
    """A function of (state, guided bodies, step) to a frame's observables; and the guided bodies at all frames."""
    system = System.of(scene)
    # Exact frame times, so that the last frame is not extrapolated by rounding.
    times = scene.motion.frame_times()

    def look(state: State, guide: Guide, step: Scalar) -> Observation:
        now, patella, center = instant_and_frame(scene, state, guide)
        reports = {e.name: e.report(now, m) for e, m in zip(system.effects, state.memories, strict=True)}
        seen = {name: shown for name, (shown, _) in reports.items()}
        stored = {name: energy for name, (_, energy) in reports.items() if energy is not None}
        status = status_of_frame(scene, seen, state, step, chosen.diagnostics(state).residual)
        status = status | status_of_lines(system, now)
        kinetic = system.kinetic_energy(state) if chosen.inertia else jnp.zeros_like(step)
        return Observation(patella, center, seen, kinetic, stored, status)

    return look, Guide.sample(scene.motion, times)
