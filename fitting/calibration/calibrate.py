"""`calibrate`: how often do a trained posterior's intervals hold the truth of plants that the twin does not know?"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.calibration.laboratory import Laboratory
from fitting.calibration.operations import OUTCOMES, Operated, Operation
from fitting.calibration.plants import PLANTS, Knee, Maker, Plant
from fitting.calibration.result import Answers, Calibration, Plans
from fitting.calibration.runs import check_truth, run, truth_of
from fitting.channel_checks import limits_of
from fitting.estimate import Estimate
from fitting.inference.infer import DRAWS
from fitting.set_up import listed
from fitting.trained import TrainedPosterior
from pftwin.base.errors import InputError, PftwinError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene, check

Floats = NDArray[np.float64]

PER_KIND = 100  # plants
_OWN_STREAM = 7  # of random numbers: not those of a training with the same seed


def calibrate(
    trained: TrainedPosterior,
    scene: Scene,
    *,
    plants: int = PER_KIND,
    kinds: Mapping[str, Maker] | None = None,
    laboratory: Laboratory | None = None,
    operation: Operation | None = None,
    seed: int = 0,
    limits: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Calibration:
    """Plants of several kinds are simulated and recorded, and the posterior answers each recording.

    Args:
        trained: the posterior.
        scene: of its set-up; plants move in its motion.
        plants: of each kind.
        kinds: functions that make a plant, by name; by default those of `fitting.calibration.plants`.
        laboratory: how plants are recorded; by default as on the virtual rig.
        operation: what is predicted of each plant from its answer, beside what the treated plant does. Answers are then
            looked at as `TrainedPosterior.estimate` does.
        seed: of all random choices.
        limits: as `TrainedPosterior.estimate` has them.
        progress: told the kind of plant, how many of them were answered, and of how many.

    Raises:
        InputError: a posterior of several trials; no plants, or no kind of them; a kind that this scene cannot have;
            another number of frames than it was trained for; a recording too short for the laboratory's filter; an
            operation that this knee cannot have.
    """
    if len(trained.set_up.frames) > 1:
        raise InputError("a posterior of several trials", where="trained", expected="one of a single trial")
    if not isinstance(plants, int) or plants < 1:
        raise InputError(f"found {plants!r}", where="plants", expected="a whole number, at least 1")
    began, made = time.perf_counter(), PLANTS if kinds is None else kinds
    if not made:
        raise InputError("no kind of plants", where="kinds", expected=f"some of: {', '.join(PLANTS)}; or functions")
    limits_of(limits)
    check(scene)
    frames = scene.motion.times.size
    if trained.set_up.frames != (frames,):
        expected = f"{listed(trained.set_up.frames)}, as the posterior was trained for"
        raise InputError(f"{frames} frames", where=scene.name, expected=expected)
    if operation is not None:
        operation.check(scene)
    scenes, parameters = trained.set_up.parameters([scene])
    asking = _Asking(trained, Knee(scenes[0], parameters[0]), laboratory or Laboratory(), scene, operation, limits)
    found: dict[str, Answers] = {}
    told: dict[str, dict[str, Any]] = {"predictions": {}, "plans": {}}
    for index, (kind, make) in enumerate(made.items()):
        random = np.random.default_rng([seed, index, _OWN_STREAM])
        members = [make(asking.knee, random) for _ in range(plants)]
        found[kind], operated = asking.answers(members, random, partial(progress, kind) if progress else None)
        if operation is not None:
            told["predictions"][kind] = Answers.of_predictions(operated, OUTCOMES)
        if operation is not None and operation.limits:
            told["plans"][kind] = Plans.of(operated, operation.confidence)
    asked = asking.knee.parameters
    words = operation.describe() if operation is not None else ""
    seconds = time.perf_counter() - began
    return Calibration(asked.names[: asked.asked], found, trained.sentence(), seed, seconds, words, **told)


class _Asking(NamedTuple):
    """What plants are asked."""

    trained: TrainedPosterior
    knee: Knee
    lab: Laboratory
    scene: Scene
    operation: Operation | None
    limits: Mapping[str, tuple[float, float]] | None

    def answers(
        self, plants: list[Plant], random: np.random.Generator, progress: Callable[[int, int], None] | None
    ) -> tuple[Answers, list[Operated]]:
        """Of plants of one kind, and what is predicted of those that are answered without a doubt."""
        parameters = self.knee.parameters
        check_truth(plants[0], parameters)
        rows: list[tuple[Floats, Floats, bool]] = []
        dropped, refused, operated = 0, 0, []
        for i, (plant, seen) in enumerate(zip(plants, run(plants), strict=True)):
            if progress is not None:
                progress(i, len(plants))
            if seen is None:
                dropped += 1
                continue
            motion, measured = self.lab.recorded(plant.scene, seen, self.trained.set_up.springs, random)
            recorded = replace(self.scene, motion=motion)
            try:
                draws, doubts, estimate = self._answer(recorded, measured)
            except PftwinError:  # of this recording; what the caller got wrong was told before
                refused += 1
                continue
            rows.append((truth_of(plant, seen, parameters), draws, bool(doubts)))
            if self.operation is not None and estimate is not None and not doubts:
                operated.append(self.operation.on(plant.scene, recorded, estimate))
        return Answers.of(rows, dropped, refused, parameters.asked), operated

    def _answer(self, recorded: Scene, measured: Measured) -> tuple[Floats, Sequence[str], Estimate | None]:
        """Draws of what is asked for, doubts, and, where something is to be predicted from it, the whole estimate."""
        if self.operation is None:
            return *self.trained.draws(recorded, measured, limits=self.limits), None
        estimate = self.trained.estimate(recorded, measured, limits=self.limits)
        return estimate.samples(DRAWS)[:, : estimate.asked], estimate.doubts, estimate
