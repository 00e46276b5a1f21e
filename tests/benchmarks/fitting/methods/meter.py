"""The one door to the evaluations: what passes is counted, timed, and the best of it remembered.

What counts as an evaluation: a point counts once; a point with its derivatives by p parameters, in whichever mode,
counts 1 + p times. All points are simulated with the same time step.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fitting.evaluation import Evaluator
from fitting.methods.problem import Problem, ProblemAnswer, Request
from pftwin.base.arrays import Floats

FAILED = 1.0  # what a point that cannot be simulated is said to be worth, where infinity would not do [m]


class Budget(NamedTuple):
    """A run goes on until both are spent, or it ends by itself."""

    evaluations: int
    seconds: float  # of processor time


class Best(NamedTuple):
    """The best so far, when it was found."""

    evaluations: int
    cpu: float  # processor time of the process [s]
    wall: float  # [s]
    value: float  # of the objective
    theta: list[float]


@dataclass
class Course:
    """One run of one method: every improvement, and where it ended."""

    method: str
    seed: int
    bests: list[Best] = field(default_factory=list)
    evaluations: int = 0
    batches: int = 0
    cpu: float = 0.0
    wall: float = 0.0
    stopped: str = ""

    def at_evaluations(self, most: int) -> Best | None:
        """The best of the first so many evaluations; None before the first batch that could be simulated."""
        return next((b for b in reversed(self.bests) if b.evaluations <= most), None)

    def at_time(self, cpu: float) -> Best | None:
        """The best of the first seconds of processor time."""
        return next((b for b in reversed(self.bests) if b.cpu <= cpu), None)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {**asdict(self), "bests": [list(b) for b in self.bests]}

    @staticmethod
    def from_dict(data: dict[str, Any]) -> Course:
        """From `to_dict`'s answer."""
        return Course(**{**data, "bests": [Best(*b) for b in data["bests"]]})


class SpentError(Exception):
    """The budget is spent: it leads out of a library's loop."""


@dataclass(eq=False)
class OneStepEvaluator(Evaluator):
    """An evaluator for which long and short time steps are the same, so that all methods see the same objective."""

    steps: int = 2  # between two frames

    @property
    def coarse(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Steps between two frames."""
        return self.steps

    @property
    def fine(self) -> int:
        """Steps between two frames."""
        return self.steps


class Meter:
    """A problem whose every evaluation is noted. The clock starts with it.

    Args:
        problem: with an evaluator of one time step.
        course: to be filled.
        budget: of the run.
    """

    def __init__(self, problem: Problem, course: Course, budget: Budget) -> None:
        self.problem, self.course, self.budget = problem, course, budget
        self._cpu, self._wall = time.process_time(), time.perf_counter()

    def answer(self, request: Request) -> ProblemAnswer:
        """What the problem answers.

        Raises:
            SpentError: the budget is spent.
        """
        self.check()
        answer = self.problem.answer(request)
        theta = np.atleast_2d(request.theta)
        each = 1 if request.want == "value" else 1 + theta.shape[1]
        self.note(theta, answer.value, each * len(theta))
        return answer

    def values(self, theta: Floats) -> Floats:
        """The objective (N,) of points (N, p); `FAILED` where there is none.

        Raises:
            SpentError: the budget is spent.
        """
        value = self.answer(Request(np.atleast_2d(theta), self.problem.evaluator.coarse)).value
        return np.where(np.isfinite(value), value, FAILED)

    def note(self, theta: Floats, value: Floats, evaluations: int) -> None:
        """A batch that was evaluated: points (N, p), their objective (N,), and what it counts."""
        c = self.course
        c.evaluations += evaluations
        c.batches += 1
        c.cpu, c.wall = time.process_time() - self._cpu, time.perf_counter() - self._wall
        i = int(np.argmin(np.where(np.isfinite(value), value, np.inf)))
        best = c.bests[-1].value if c.bests else np.inf
        if np.isfinite(value[i]) and value[i] < best:
            c.bests.append(Best(c.evaluations, c.cpu, c.wall, float(value[i]), np.asarray(theta[i]).tolist()))

    def check(self) -> None:
        """Ends the run where the budget is spent.

        Raises:
            SpentError: it is.
        """
        if self.course.evaluations >= self.budget.evaluations and self.course.cpu >= self.budget.seconds:
            raise SpentError
