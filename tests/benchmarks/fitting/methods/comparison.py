"""All methods on one problem, over many seeds, warm.

The problem is the paper's: K1, L1, K2 and L2 from the motion of case 2. The rig's nominal springs are its true ones, so
a search that began at them would begin at its goal: every seed gives all methods another guess, anywhere in the middle
half of the bounds. Each method uses its own defaults. All see the objective at one time step, nothing is refined
afterwards, and at last the best points of all are looked at with short steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.evaluation import Evaluator
from fitting.methods.problem import Problem, Request
from fitting.objective import Objective
from fitting.parameters import Parameters
from pftwin.base.arrays import Floats
from tests.benchmarks.fitting.methods.entrants import ENTRANTS, Entrant
from tests.benchmarks.fitting.methods.meter import Budget, Course, Meter, OneStepEvaluator, SpentError

_WARMING = 20240418  # a seed that is not counted: its run compiles


@dataclass(frozen=True, eq=False)
class Setting:
    """What is fitted to what, and for how long."""

    objective: Objective
    evaluator: Evaluator  # of the scene and its parameters; decides the time steps
    budget: Budget
    seeds: int

    @property
    def nominal(self) -> Parameters:
        """With the scene's values."""
        return self.evaluator.parameters

    def guess(self, seed: int) -> Parameters:
        """The parameters with another nominal value, anywhere in the middle half of the bounds."""
        p = self.nominal
        share = np.random.default_rng([seed, 1]).uniform(0.25, 0.75, len(p))
        values = p.lower + share * (p.upper - p.lower)
        return Parameters(tuple(replace(q, nominal=float(v)) for q, v in zip(p.items, values, strict=True)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Courses by method, and the objective of their best points with short steps."""

    courses: dict[str, list[Course]]
    names: tuple[str, ...]  # of the parameters
    true: Floats  # the rig's springs (p,)
    budget: Budget
    fine: dict[str, Floats]  # (seeds, 2): at equal evaluations and at equal time; infinite where there is nothing
    best: float  # the least of all with short steps


def compared(
    setting: Setting, entrants: Sequence[Entrant] = ENTRANTS, say: Callable[[str], None] = print
) -> Comparison:
    """Runs every method from every seed."""
    courses = {}
    for entrant in entrants:
        courses[entrant.name] = runs(setting, entrant)
        last = [c.bests[-1].value for c in courses[entrant.name] if c.bests]
        say(f"  {entrant.label}: {1e3 * float(np.median(last)) if last else np.nan:.4f} mm")
    fine = _with_short_steps(setting, courses)
    best = min(float(np.min(values)) for values in fine.values())
    return Comparison(courses, setting.nominal.names, setting.nominal.nominal, setting.budget, fine, best)


def runs(setting: Setting, entrant: Entrant) -> list[Course]:
    """One method from every seed; one run before them compiles and is not counted."""
    scene = setting.evaluator.scene
    channels, steps = setting.evaluator.channels, setting.evaluator.coarse
    evaluator = OneStepEvaluator(scene, setting.nominal, channels, steps=steps)
    evaluator.prepare(entrant.widest(Problem(scene, setting.nominal, setting.objective, evaluator)))
    found = []
    for seed in (_WARMING, *range(setting.seeds)):
        problem = Problem(scene, setting.guess(seed), setting.objective, evaluator)
        course = Course(entrant.name, seed)
        meter = Meter(problem, course, setting.budget)
        try:
            course.stopped = entrant.run(meter, seed)
        except SpentError:
            course.stopped = "budget spent"
        found.append(course)
    return found[1:]


def _with_short_steps(setting: Setting, courses: dict[str, list[Course]]) -> dict[str, Floats]:
    """The objective of every run's best point at equal evaluations and at equal time (seeds, 2)."""
    evaluations, seconds = setting.budget
    places, points = [], []
    fine = {name: np.full((len(runs), 2), np.inf) for name, runs in courses.items()}
    for name, own in courses.items():
        for i, course in enumerate(own):
            for k, best in enumerate((course.at_evaluations(evaluations), course.at_time(seconds))):
                if best is not None:
                    places.append((name, i, k))
                    points.append(best.theta)
    problem = Problem(setting.evaluator.scene, setting.nominal, setting.objective, setting.evaluator)
    # With derivatives nobody needs, by the program that is there already.
    values = problem.answer(Request(np.array(points), setting.evaluator.fine, "normal")).value
    for (name, i, k), value in zip(places, values, strict=True):
        fine[name][i, k] = value
    return fine
