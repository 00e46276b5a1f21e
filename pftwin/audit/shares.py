"""What a part of a scene takes of a step's time: measured with and without it, in turn, along one and the same path.

On a CPU its own time counts, which other programs on the machine disturb far less than the clock on the wall.

Every frame begins from the state of the whole scene's run there, so that a scene which would fly apart without a part
is timed where the motion is, not where it would have gone.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from pftwin.audit.step import frame_time, guide_over, one_step, step_length
from pftwin.base.program_cache import Program
from pftwin.dynamics.state import State
from pftwin.scene import Scene
from pftwin.spatial import Scalar

ROUNDS, SECONDS, MOST = 9, 0.3, 60  # at least so many rounds and seconds for each, at most so many rounds


@dataclass(frozen=True)
class Share:
    """A time beside that of the first one measured."""

    seconds: float  # median of all runs [s]
    ratio: float  # to the first: median of the rounds
    spread: float  # of the ratio: half of what the middle half of the rounds covers


@Program
def through_frames(scene: Scene, states: State, integrator: str, substeps: int) -> Scalar:
    """All steps of a run, every frame from its own given state; a number that all of them enter."""
    system, motion = scene.system(), scene.motion
    step = step_length(motion, substeps)

    def one_frame(index: Scalar, total: Scalar) -> Scalar:
        piece, began = motion.between_frames(index), frame_time(motion, index)

        def further(k: Scalar, state: State) -> State:
            return one_step(system, state, guide_over(piece, began + step * k.astype(float), step), step, integrator)

        end = jax.lax.fori_loop(0, substeps, further, jax.tree.map(lambda a: a[index], states))
        return total + sum(jax.tree.leaves((end.position, end.velocity, end.spin)), start=end.orientation.w)

    return jax.lax.fori_loop(0, motion.n_frames - 1, one_frame, jnp.zeros((), float))


def in_turn(runs: Sequence[Callable[[], Any]]) -> list[Share]:
    """Times of runs, whose answers are there when they return, relative to the first one's; one of each in turn."""
    clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter

    def once(run: Callable[[], Any]) -> float:
        began = clock()
        run()
        return clock() - began

    for run in runs:
        run()
    rounds: list[list[float]] = []
    while len(rounds) < ROUNDS or (sum(map(sum, rounds)) < SECONDS * len(runs) and len(rounds) < MOST):
        rounds.append([once(run) for run in runs])
    return [_share([r[i] for r in rounds], [r[i] / r[0] for r in rounds]) for i in range(len(runs))]


def _share(seconds: list[float], ratios: list[float]) -> Share:
    low, middle, high = statistics.quantiles(ratios, n=4)
    return Share(statistics.median(seconds), middle, 0.5 * (high - low))
