"""Shared functions of the studies: interruptible runs of variants, timing in turn, and comparison of motions."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.leaves import host_array
from pftwin.base.spatial import Quaternion
from pftwin.results.result import Result

MOST_ROUNDS = 60
V = TypeVar("V")
A = TypeVar("A")


def run_each(
    variants: Sequence[V],
    run: Callable[[V], A],
    *,
    before: Callable[[int, V], Any] = lambda k, variant: None,
    after: Callable[[list[A]], Any] = lambda answers: None,
) -> list[A]:
    """Runs variants one after the other; after an interrupt (Ctrl-C), returns the answers so far.

    `before` is called with the number done and the next variant, `after` with all answers so far. Raises
    KeyboardInterrupt if it comes before the first variant is done.
    """
    answers: list[A] = []
    try:
        for k, variant in enumerate(variants):
            before(k, variant)
            answers.append(run(variant))
            after(answers)
    except KeyboardInterrupt:
        if not answers:
            raise
    return answers


@dataclass(frozen=True)
class Cost:
    """The time of a run and its ratio to that of the first run timed with it."""

    seconds: float  # median over the rounds [s]
    ratio: float  # to the first run, median over the rounds
    spread: float  # of the ratio: half the interquartile range over the rounds


def time_in_turn(
    runs: Sequence[Callable[[], Any]],
    *,
    rounds: int = 9,
    seconds: float = 0.3,
    own: bool = True,
    before: Callable[[int], Any] = lambda k: None,
) -> list[Cost]:
    """Times runs in turn, after a first call that compiles each, so that other load affects all of them equally.

    Args:
        runs: functions to time; each is timed until its arrays are ready.
        rounds, seconds: minimum number of rounds and minimum time for each run [s], up to `MOST_ROUNDS` rounds.
        own: whether to use process time on a CPU, which other programs disturb less than wall time.
        before: called with the number of runs compiled so far, before each is compiled.
    """
    clock = time.process_time if own and jax.default_backend() == "cpu" else time.perf_counter

    def once(run: Callable[[], Any]) -> float:
        began = clock()
        jax.block_until_ready(run())
        return clock() - began

    for k, run in enumerate(runs):
        before(k)
        jax.block_until_ready(run())
    taken: list[list[float]] = []
    while len(taken) < rounds or (sum(map(sum, taken)) < seconds * len(runs) and len(taken) < MOST_ROUNDS):
        taken.append([once(run) for run in runs])
    return [_cost([r[i] for r in taken], [r[i] / r[0] for r in taken]) for i in range(len(runs))]


def _cost(seconds: list[float], ratios: list[float]) -> Cost:
    low, middle, high = statistics.quantiles(ratios, n=4)
    return Cost(statistics.median(seconds), middle, 0.5 * (high - low))


class Difference(NamedTuple):
    """Difference of a motion from a reference motion at the same n frames."""

    center: Floats  # (n,) distance between the two positions of a point of the patella in the femur frame [m]
    flexion: Floats  # (n,) [rad]
    rotation: Floats  # (n,) [rad]
    tilt: Floats  # (n,) [rad]
    contact: Floats | None  # (n,) of the contact force [N]; None if either has none


def difference(result: Result, reference: Result, point: Floats) -> Difference:
    """Returns the difference of two motions; `point` (3,) [m] in the patella frame is the point whose path counts."""
    distance = np.linalg.norm(_path(result, point) - _path(reference, point), axis=1)
    pairs = ((getattr(r.angles, name) for r in (result, reference)) for name in ("flexion", "rotation", "tilt"))
    flexion, rotation, tilt = (np.angle(np.exp(1j * np.subtract(*pair))) for pair in pairs)
    force = None
    if reference.contact is not None and "force" in result.effects.get(reference.contact, {}):
        force = result.effects[reference.contact]["force"] - reference.effects[reference.contact]["force"]
    return Difference(distance, flexion, rotation, tilt, force)


def rms(a: Floats) -> float:
    """Returns the root mean square."""
    return float(np.sqrt(np.mean(np.square(a))))


def _path(result: Result, point: Floats) -> Floats:
    """The path of a point of the patella in the femur frame (n, 3) [m]."""
    turn = Quaternion(*result.quaternion.T).rotation()
    axes = [host_array(a) for a in (turn.ex, turn.ey, turn.ez)]
    return result.position + sum(p * a for p, a in zip(point, axes, strict=True))
