"""`calibrate`: how often do a trained posterior's intervals hold the truth of plants that the twin does not know?"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.calibration.laboratory import Laboratory
from fitting.calibration.operations import OUTCOMES, Operated, Operation
from fitting.calibration.plants import PLANTS, Knee, Maker
from fitting.calibration.result import Answers, Calibration, Plans
from fitting.calibration.runs import check_truth, run, truth_of
from fitting.channel_checks import limits_of
from fitting.inference.infer import DRAWS
from fitting.set_up import listed
from fitting.trained import TrainedPosterior
from pftwin.base.errors import InputError, PftwinError
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
            another number of frames than it was trained for; a recording too short for the laboratory's filter.
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
    scenes, parameters = trained.set_up.parameters([scene])
    knee, lab = Knee(scenes[0], parameters[0]), laboratory or Laboratory()
    asked = knee.parameters.asked
    found: dict[str, Answers] = {}
    operated: dict[str, list[Operated]] = {}
    for index, (kind, make) in enumerate(made.items()):
        random = np.random.default_rng([seed, index, _OWN_STREAM])
        members = [make(knee, random) for _ in range(plants)]
        check_truth(members[0], knee.parameters)
        rows: list[tuple[Floats, Floats, bool]] = []
        dropped, refused, done = 0, 0, []
        for i, (plant, seen) in enumerate(zip(members, run(members), strict=True)):
            if progress is not None:
                progress(kind, i, plants)
            if seen is None:
                dropped += 1
                continue
            motion, measured = lab.recorded(plant.scene, seen, trained.set_up.springs, random)
            recorded, estimate = replace(scene, motion=motion), None
            try:
                if operation is None:
                    draws, doubts = trained.draws(recorded, measured, limits=limits)
                else:
                    estimate = trained.estimate(recorded, measured, limits=limits)
                    draws, doubts = estimate.samples(DRAWS)[:, :asked], estimate.doubts
            except PftwinError:  # this recording; what the caller got wrong was told above
                refused += 1
                continue
            rows.append((truth_of(plant, seen, knee.parameters), draws, bool(doubts)))
            if operation is not None and estimate is not None and not doubts:
                done.append(operation.on(plant.scene, recorded, estimate))
        found[kind], operated[kind] = Answers.of(rows, dropped, refused, asked), done
    told: dict[str, Any] = {}
    if operation is not None:
        told["operation"] = operation.describe()
        told["predictions"] = {kind: Answers.of_predictions(done, OUTCOMES) for kind, done in operated.items()}
    if operation is not None and operation.limits:
        told["plans"] = {kind: Plans.of(done, operation.confidence) for kind, done in operated.items()}
    names = knee.parameters.names[:asked]
    return Calibration(names, found, trained.sentence(), seed, time.perf_counter() - began, **told)
