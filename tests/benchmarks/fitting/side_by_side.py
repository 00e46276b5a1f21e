"""Many fits of one motion in step with each other: what all of them ask for is evaluated in common batches.

Each fit is `fitting.methods.least_squares` as it stands: alone it asks for few points at once, together for many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fitting.evaluation import Evaluator, Prediction
from fitting.methods.least_squares import LeastSquares
from fitting.methods.problem import Problem, ProblemAnswer, Request
from fitting.objective import Objective


@dataclass(eq=False)
class WideEvaluator(Evaluator):
    """An evaluator with wider batches of derivatives than a single fit can use."""

    width: int = 64

    @property
    def slope_chunk(self) -> int:
        """Variants in one call with derivatives."""
        return self.width


@dataclass(eq=False)
class Seat(Evaluator):
    """What one of many fits sees of their common evaluator: which time steps it has."""

    few: int = 2
    many: int = 6

    @property
    def coarse(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Steps between two frames for a search."""
        return self.few

    @property
    def fine(self) -> int:
        """Steps between two frames for an answer."""
        return self.many


def fitted(common: Evaluator, objectives: Sequence[Objective], starts: int, seed: int) -> list[dict[str, Any]]:
    """Fits of one scene to many measurements; the last state of each.

    Args:
        common: of the scene; its channels begin with those of every objective.
        objectives: one per fit.
        starts: of each fit; all fits have the same.
        seed: of the starts.
    """
    scene, p = common.scene, common.parameters
    seat = Seat(scene, p, common.channels, few=common.coarse, many=common.fine)
    searches = [LeastSquares(Problem(scene, p, o, seat), seed, starts) for o in objectives]
    states = [search.begin() for search in searches]
    while running := [i for i, state in enumerate(states) if state["stopped"] is None]:
        asked = {i: searches[i].ask(states[i]) for i in running}
        for substeps in {request.substeps for request in asked.values()}:
            alike = {i: request for i, request in asked.items() if request.substeps == substeps}
            for i, prediction in _predicted(common, alike, substeps).items():
                answer = ProblemAnswer(*objectives[i].normal(seen_by(objectives[i], prediction)))
                searches[i].tell(states[i], alike[i], answer)
    return states


def _predicted(common: Evaluator, alike: dict[int, Request], substeps: int) -> dict[int, Prediction]:
    """Every fit's share of one evaluation."""
    whole = common.with_slopes(np.concatenate([request.theta for request in alike.values()]), substeps)
    assert whole.slopes is not None
    ends = np.cumsum([len(request.theta) for request in alike.values()])
    parts = [slice(end - len(request.theta), end) for end, request in zip(ends, alike.values(), strict=True)]
    return {
        i: Prediction(whole.values[part], whole.slopes[part], whole.usable[part])
        for i, part in zip(alike, parts, strict=True)
    }


def seen_by(objective: Objective, prediction: Prediction) -> Prediction:
    """The channels that an objective compares: the first ones."""
    width = objective.measured.shape[1]
    slopes = prediction.slopes
    return Prediction(
        prediction.values[..., :width], None if slopes is None else slopes[..., :width, :], prediction.usable
    )
