"""Simulates several trials of one knee, joined to one long recording: see `fitting.trials`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fitting.evaluation import Evaluator, Prediction, StepError
from fitting.parameters import weights_in
from fitting.trials import rows_of_trials
from pftwin.base.arrays import Floats
from pftwin.model.scene import Scene


@dataclass(eq=False)
class TrialsEvaluator:
    """`Evaluator` for several trials. Numbers of steps between two frames are those of the first trial."""

    evaluators: tuple[Evaluator, ...]  # of each trial, for the shared parameters
    differences: tuple[tuple[int, int], ...] = ()  # as `Parameters.differences`; their columns follow the shared ones

    def __post_init__(self) -> None:
        nominal = [e.parameters.nominal for e in self.evaluators]
        self._moved = [own - nominal[0] for own in nominal]
        self._weights = [weights_in(self.differences, len(nominal[0]), k) for k in range(len(self.evaluators))]
        self.scenes = tuple(scene for each in self.evaluators for scene in each.scenes)
        self.in_turns = any(each.in_turns for each in self.evaluators)
        first = self.evaluators[0]
        self.computed, self.first, self.slope_chunk = first.computed, first.first, first.slope_chunk

    def prepare(self, widest: int | None) -> None:
        """As `Evaluator.prepare`."""
        for each in self.evaluators:
            each.prepare(widest)

    def begin(self) -> Callable[[], None]:
        """As `Evaluator.begin`, of the first trial; those of others differ only if their numbers of frames do."""
        return self.evaluators[0].begin()

    def scenes_at(self, theta: Floats) -> tuple[Scene, ...]:
        """The scene of every trial with parameters (p,)."""
        return tuple(e.parameters.apply(e.scene, at[0]) for e, at, _ in self._trials(theta, self.first))

    @cached_property
    def coarse(self) -> int:
        """As `Evaluator.coarse`, for the trial that needs the shortest steps."""
        return max(self._steps_in_first(each, each.coarse) for each in self.evaluators)

    @cached_property
    def fine(self) -> int:
        """As `Evaluator.fine`, likewise."""
        return max(self._steps_in_first(each, each.fine) for each in self.evaluators)

    def short_enough(self, *, slopes: bool = True) -> int:
        """As `Evaluator.short_enough`, likewise."""
        return max(self._steps_in_first(each, each.short_enough(slopes=slopes)) for each in self.evaluators)

    @property
    def pull_chunk(self) -> int:
        """As `Evaluator.pull_chunk`."""
        return self.evaluators[0].pull_chunk

    @pull_chunk.setter
    def pull_chunk(self, chunk: int) -> None:
        for each in self.evaluators:
            each.pull_chunk = chunk

    def values(self, theta: Floats, substeps: int) -> Prediction:
        """As `Evaluator.values`."""
        return _joined([e.values(at, steps) for e, at, steps in self._trials(theta, substeps)])

    def with_slopes(self, theta: Floats, substeps: int) -> Prediction:
        """As `Evaluator.with_slopes`."""
        parts = []
        for (e, at, steps), weights in zip(self._trials(theta, substeps), self._weights, strict=True):
            found = e.with_slopes(at, steps)
            assert found.slopes is not None
            parts.append(found._replace(slopes=found.slopes @ weights))
        return _joined(parts)

    def gradients(self, theta: Floats, substeps: int, pulls: Floats) -> Floats:
        """As `Evaluator.gradients`."""
        lengths = [len(scene.motion.times) for scene in self.scenes]
        parts = zip(self._trials(theta, substeps), rows_of_trials(lengths), self._weights, strict=True)
        return np.sum([e.gradients(at, steps, pulls[:, rows]) @ w for (e, at, steps), rows, w in parts], axis=0)

    def step_errors(self, theta: Floats, substeps: int, *, slopes: bool = True) -> dict[str, StepError]:
        """As `Evaluator.step_errors`, from the trial in which a channel's error is largest."""
        found = [e.step_errors(at[0], steps, slopes=slopes) for e, at, steps in self._trials(theta[None], substeps)]
        if not all(found):
            return {}
        return {channel: max((each[channel] for each in found), key=lambda e: (e.large, e.rms)) for channel in found[0]}

    def _trials(self, theta: Floats, substeps: int) -> list[tuple[Evaluator, Floats, int]]:
        """Every trial's evaluator, with its parameters (N, p) and steps."""
        theta, first = np.atleast_2d(np.asarray(theta, dtype=np.float64)), self.first
        return [
            (each, theta @ weights.T + moved, -(-substeps * each.first // first))
            for each, weights, moved in zip(self.evaluators, self._weights, self._moved, strict=True)
        ]

    def _steps_in_first(self, each: Evaluator, substeps: int) -> int:
        """Steps between two frames of the first trial that are no longer than these of another trial."""
        return -(-substeps * self.first // each.first)


def _joined(parts: list[Prediction]) -> Prediction:
    """Joins the trials' predictions; usable if all are."""
    usable = np.logical_and.reduce([p.usable for p in parts])
    slopes = [p.slopes for p in parts if p.slopes is not None]
    values = _concatenated([p.values for p in parts])
    return Prediction(values, _concatenated(slopes) if slopes else None, usable)


def _concatenated(parts: list[Floats]) -> Floats:
    """Joins arrays (N, n, ...) along the frames, with a frame of zeros between two."""
    between = np.zeros_like(parts[0][:, :1])
    return np.concatenate([part for one in parts for part in (between, one)][1:], axis=1)
