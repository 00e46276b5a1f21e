"""Two trials of a small knee, of unlike height and rate, or of unlike height: tests of several files share programs.

A rate of its own is a program of its own: what is not about rates takes the two that are alike, which are simulated by
the program of `small_scene()`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

from lifting_scene import lifting_scene

from fitting.methods.problem import Problem
from fitting.nuisance import EXACT
from fitting.objective import SPRINGS
from fitting.trials import free_in_trials, objective_of
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

POINT = "patellar_tendon.insertion.y"
FREE = ("K1", "L2", POINT)
BOUNDS = {"K1": 0.3, "L2": 0.3, POINT: (-0.02, 0.02)}
MOVED = 0.003  # by how much the second trial has the insertion elsewhere, as after a treatment [m]
COMPUTED = ("position", "quadriceps")
STEPS = (48, 40)  # between two frames of each, at which fits of motions without noise end


@cache
def nominal() -> tuple[Scene, Scene]:
    """Their scenes, of unlike rate."""
    return low(), high(0.008)


@cache
def alike() -> tuple[Scene, Scene]:
    """The same of one rate."""
    return low(), high(0.01)


def low() -> Scene:
    return replace(lifting_scene(height=0.05), name="low")


def high(interval: float) -> Scene:
    scene = replace(lifting_scene(height=0.07, interval=interval), name="high")
    return scene.set(POINT, float(scene.get(POINT)) + MOVED)


def problem_of(
    trials: Sequence[int],
    data: Sequence[Measured],
    noise: Mapping[str, float],
    varies: Mapping[str, float] | None = None,
) -> Problem:
    """Of some of the trials, measured so, by the channels whose noise is given; one program serves them all."""
    scenes, own = free_in_trials([nominal()[i] for i in trials], FREE, BOUNDS, None, EXACT, varies)
    target = objective_of(scenes, data, "likelihood", tuple(noise), noise, "linear", SPRINGS)
    return Problem.of(scenes, own, target, computed=COMPUTED)
