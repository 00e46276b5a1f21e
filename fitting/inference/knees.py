"""The knees that are simulated to learn from: the twin's, with tendons that stiffen where nuisance says so."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.evaluation import Evaluator, Prediction
from fitting.methods.problem import Problem
from fitting.parameters import Parameters, free_parameters
from fitting.stiffening import Working, linear_tendons, stiffened
from fitting.trials_evaluator import TrialsEvaluator
from pftwin.dynamics.simulate import simulate

Floats = NDArray[np.float64]

_GRID = 5  # values of a slack length from which the bounds of bent springs are found


class Bent(NamedTuple):
    """A tendon that may stiffen."""

    name: str
    stiffness: int  # its column among the parameters
    slack_length: int
    working: Working


@dataclass(frozen=True)
class Knees:
    """Predictions for parameters of the twin, by knees whose tendons stiffen by chance, evenly from 0 to the most.

    Of a tendon that stiffens the twin's stiffness and slack length are those of the line nearest to its spring over the
    lengths at which the nominal knee works.
    """

    evaluator: Evaluator | TrialsEvaluator
    bent: tuple[Bent, ...]
    most: float

    @staticmethod
    def of(problem: Problem, most: float, together: int) -> Knees:
        """Of a problem: its linear tendons of which stiffness and slack length are free stiffen.

        Args:
            problem: with its evaluator.
            most: share by which they do when stretched by a quarter of their length.
            together: simulations in a call.
        """
        if not most:
            return Knees(problem.evaluator, (), most)
        places = [p.place for p in problem.parameters.items]
        columns = {place[:2]: i for i, place in enumerate(places) if place.meaning == "value"}
        linear = linear_tendons(problem.scene)
        names = [n for n in linear if {(n, ("stiffness",)), (n, ("slack_length",))} <= columns.keys()]
        if not names:
            return Knees(problem.evaluator, (), most)
        runs = [simulate(scene).lengths for scene in problem.evaluator.scenes]
        bent = tuple(
            Bent(
                name,
                columns[name, ("stiffness",)],
                columns[name, ("slack_length",)],
                Working.of(np.concatenate([lengths[name] for lengths in runs])),
            )
            for name in names
        )
        own = tuple(_with_bent(each, bent, most) for each in problem.evaluator.own)
        evaluator = own[0] if len(own) == 1 else TrialsEvaluator(own)
        evaluator.prepare(together)
        return Knees(evaluator, bent, most)

    def values(self, theta: Floats, substeps: int, random: np.random.Generator) -> Prediction:
        """Predictions for (N, p) parameters."""
        if not self.bent:
            return self.evaluator.values(theta, substeps)
        shares, made = random.uniform(0.0, self.most, (len(theta), len(self.bent))), theta.copy()
        for column, b in zip(shares.T, self.bent, strict=True):
            made[:, b.stiffness], made[:, b.slack_length], column[:] = b.working.bent(
                theta[:, b.stiffness], theta[:, b.slack_length], column
            )
        return self.evaluator.values(np.concatenate([made, shares], axis=1), substeps)


def _with_bent(evaluator: Evaluator, bent: tuple[Bent, ...], most: float) -> Evaluator:
    """The same of a scene whose tendons stiffen, with their shares as further parameters."""
    scene = stiffened(evaluator.scene, {b.name: 0.5 * most for b in bent})
    items = list(evaluator.parameters.items)
    for b in bent:
        k, length = items[b.stiffness], items[b.slack_length]
        lengths = np.linspace(length.lower, length.upper, _GRID)
        least, shorter, _ = b.working.bent(np.full(_GRID, k.lower), lengths, np.full(_GRID, most))
        items[b.stiffness] = replace(k, lower=float(least.min()))
        items[b.slack_length] = replace(length, lower=float(min(length.lower, shorter.min())))
    shares = [f"{b.name}.stiffening" for b in bent]
    more = free_parameters(scene, shares, dict.fromkeys(shares, (0.0, most))).items
    return replace(evaluator, scene=scene, parameters=Parameters((*items, *more)))
