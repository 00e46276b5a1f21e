"""Time integration from a scene to the patella's states at the recorded frames, as a pure function."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Scalar
from pftwin.dynamics.equilibrium import Solution, initial_solution, solve_equilibrium
from pftwin.dynamics.integrator import Carry, Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.packing import Layout
from pftwin.dynamics.relaxation import relax
from pftwin.dynamics.state import Guide, State, System
from pftwin.model.scene import Scene


class FrameStates(eqx.Module):
    """States of the patella at the recorded frames (leading axis n_frames)."""

    states: State
    ledger: Ledger | None
    start: Solution  # initial equilibrium
    step: Scalar  # [s]
    integrator: Integrator = eqx.field(static=True, default=LinearImplicit())  # interprets `states.solver_state`


def substeps_for(interval: float, dt: float) -> int:
    """Smallest number of equal steps, none longer than `dt` [s], in the interval between two frames [s].

    Raises:
        InputError: `dt` is not a positive number, or traced.
    """
    if isinstance(dt, Tracer):
        raise InputError(
            "a traced value",
            where="dt",
            expected="a plain number of seconds, which determines the number of steps",
            remedy="a static argument, as in jax.jit(..., static_argnames='dt')",
        )
    if not isinstance(dt, int | float | np.number | np.ndarray | jax.Array) or np.ndim(dt) or not dt > 0:
        raise InputError(f"found {dt!r}", where="dt", expected="a positive number of seconds, such as 1e-3")
    return max(1, -int(-(interval / dt - 1e-9) // 1))


def starting_equilibrium(scene: Scene, guess: Pose | None = None) -> Solution:
    """Equilibrium at the first frame; `guess` is a pose of the patella frame, by default the scene's start pose."""
    start = scene.start if guess is None else guess
    pose = Pose(start.apply(scene.patella.center_of_mass), start.orientation)
    return solve_equilibrium(System.of(scene), first_guide(scene), pose)


def start_before_search(scene: Scene) -> Solution:
    """An unsolved `Solution` with the same structure as that of `starting_equilibrium`."""
    return initial_solution(System.of(scene), first_guide(scene), scene.center_of_mass_pose())


def relaxed_start(scene: Scene) -> Pose:
    """Rest pose of damped motion from the scene's start pose, as a pose of the patella frame to search from."""
    rested = relax(System.of(scene), first_guide(scene), scene.center_of_mass_pose())
    return Pose(rested.apply(-scene.patella.center_of_mass), rested.orientation)


def at_start(scene: Scene) -> Scene:
    """The scene with the beginning of its motion alone: its start's programs serve recordings of any length.

    Computed on the host.
    """
    if scene.motion.n_frames == 2:
        return scene  # cut already: recordings have four frames or more
    return dataclasses.replace(scene, motion=scene.motion.until_second_frame())


def first_guide(scene: Scene) -> Guide:
    """The guided bodies at the first frame, with zero velocities."""
    return Guide.sample(scene.motion, jnp.asarray(scene.motion.start_time, dtype=float)).slowed(0.0)


def starting_state(scene: Scene, start: Solution) -> State:
    """Initial state at rest relative to the femur, so that a femur that moves at the first frame causes no impact."""
    state = System.of(scene).at_rest(start.pose, start.memories)
    if scene.motion.femur is None:
        return state
    femur = scene.motion.femur.frames(jnp.asarray(scene.motion.start_time, dtype=float))
    motion = femur.velocity_at(state.position), state.orientation.unrotate(femur.angular_velocity)
    return eqx.tree_at(lambda s: (s.velocity, s.spin), state, motion)


def _parts(now: Carry) -> tuple[Any, Any]:
    """The stored values of a frame in two parts, of which the second is not computed where only poses are used."""
    state, books = now
    others = state.velocity, state.spin, state.memories, state.solver_state, books
    return (state.position, state.orientation), others


def frame_states(
    scene: Scene,
    *,
    integrator: Integrator = LinearImplicit(),
    substeps: int | Scalar = 10,
    start: Solution | None = None,
    ledger: bool = False,
) -> FrameStates:
    """States of the patella at the recorded frames, from static equilibrium.

    Args:
        scene: any of its leaves may be traced.
        integrator: see `pftwin.dynamics.integrators`.
        substeps: number of steps between two recorded frames. If traced, one program serves all numbers, but without
            reverse mode; 0 stays at the equilibrium.
        start: initial equilibrium; solved for by default.
        ledger: whether to compute the energy ledger.

    Raises:
        InputError: the integrator does not support an effect.

    Supports jit, vmap, jvp and grad. Reverse mode stores one state per frame and recomputes the steps in between.
    """
    run = _run(scene, integrator, substeps, start, ledger)

    def one_frame(now: Carry, index: Scalar) -> tuple[Carry, tuple[Array, Array]]:
        now = run.next_frame(now, index)
        return now, run.rows_of(now)

    _, rows = jax.lax.scan(one_frame, run.carry, jnp.arange(scene.motion.n_frames - 1))
    later = run.whole(rows)
    states, books = jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), run.carry, later)
    return FrameStates(states, books, run.start, run.step, integrator)


def scan_observations(
    scene: Scene,
    look: Callable[[State, Ledger | None, Scalar], Any],
    *,
    integrator: Integrator = LinearImplicit(),
    substeps: int | Scalar = 10,
    start: Solution | None = None,
    ledger: bool = False,
) -> tuple[Any, Solution, Scalar]:
    """Evaluates look(state, ledger, frame) at every recorded frame during the motion, without storing states.

    `look` is a pure function that returns a pytree of arrays. If it is cheap, a batch stores a tenth as much and takes
    half the time. See `frame_states` for the other arguments.

    Returns:
        The values of `look` (n_frames, ...), the initial equilibrium, and the step [s].
    """
    run, n = _run(scene, integrator, substeps, start, ledger), scene.motion.n_frames
    layout = Layout.of(look, *run.carry, jnp.zeros((), int))

    def one_frame(now: Carry, index: Scalar) -> tuple[Carry, Array]:
        # With `look` before the step it occurs only once in the program; the last iteration's step is not used.
        return run.next_frame(now, jnp.minimum(index, n - 2)), layout.row(look(*now, index))

    _, rows = jax.lax.scan(one_frame, run.carry, jnp.arange(n))
    return layout.unpacked(rows), run.start, run.step


class _Run(NamedTuple):
    """A prepared time integration that advances from frame to frame."""

    carry: Carry
    start: Solution
    step: Scalar
    next_frame: Callable[[Carry, Scalar], Carry]  # (values at a frame, its index) -> values at the next frame
    rows_of: Callable[[Carry], tuple[Array, Array]]  # packs the values at a frame into rows
    whole: Callable[[tuple[Array, Array]], Carry]  # unpacks rows of all frames


def _run(scene: Scene, chosen: Integrator, substeps: int | Scalar, start: Solution | None, ledger: bool) -> _Run:
    chosen.refuse_unfit(scene.effects)
    system = System.of(scene)
    if start is None:
        start = starting_equilibrium(scene)
    motion = scene.motion
    step = motion.frame_interval / jnp.maximum(substeps, 1).astype(float)
    first = Guide.sample(motion, jnp.asarray(motion.start_time, dtype=float))
    state = chosen.begin(system, starting_state(scene, start), first, step)
    carry: Carry = (state, Ledger.opened(step) if ledger else None)

    @partial(jax.checkpoint, prevent_cse=False)
    def from_rows(pose: Array, rest: Array, index: Scalar) -> Carry:
        now = jax.tree.map(lambda a: a[0], whole((pose[None], rest[None])))
        piece = motion.between_frames(index)
        began = motion.start_time + motion.frame_interval * index.astype(float)

        @partial(jax.checkpoint, prevent_cse=False)
        def one_step(k: Scalar, now: Carry) -> Carry:
            def guide_at(part: float | Scalar) -> Guide:
                return Guide.sample(piece, began + step * (jnp.asarray(k).astype(float) + part))

            after, books = chosen.advance(system, now[0], guide_at, step, now[1])
            return chosen.with_worst_residual(after, now[0]), books

        return jax.lax.fori_loop(0, substeps, one_step, (chosen.with_residual_cleared(now[0]), now[1]))

    def next_frame(now: Carry, index: Scalar) -> Carry:
        return from_rows(*rows_of(now), index)

    def rows_of(now: Carry) -> tuple[Array, Array]:
        pose, rest = _parts(now)
        return poses.row(pose), others.row(rest)

    def whole(rows: tuple[Array, Array]) -> Carry:
        pose, rest = poses.unpacked(rows[0]), others.unpacked(rows[1])
        return State(*pose, *rest[:4]), rest[4]

    poses, others = (Layout.of(lambda i=i: _parts(carry)[i]) for i in (0, 1))
    return _Run(carry, start, step, next_frame, rows_of, whole)
