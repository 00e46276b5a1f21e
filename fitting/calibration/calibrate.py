"""`calibrate`: how often do a trained posterior's intervals hold the truth of plants that the twin does not know?"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.calibration.laboratory import Laboratory
from fitting.calibration.plants import PLANTS, Knee, Maker
from fitting.calibration.result import Answers, Calibration
from fitting.calibration.runs import run, truth_of
from fitting.trained import TrainedPosterior
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene, check

Floats = NDArray[np.float64]

PER_KIND = 100  # plants
_LEVELS = (0.025, 0.975)  # of the interval of which the width is told


def calibrate(
    trained: TrainedPosterior,
    scene: Scene,
    *,
    plants: int = PER_KIND,
    kinds: Mapping[str, Maker] | None = None,
    laboratory: Laboratory | None = None,
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
        seed: of all random choices.
        limits: as `TrainedPosterior.estimate` has them.
        progress: told the kind of plant, how many of them were answered, and of how many.

    Raises:
        InputError: a posterior of several trials; no plants; a kind that this scene cannot have.
    """
    if len(trained.set_up.frames) > 1:
        raise InputError("a posterior of several trials", where="trained", expected="one of a single trial")
    if plants < 1:
        raise InputError(f"found {plants!r}", where="plants", expected="at least 1")
    check(scene)
    began, made = time.perf_counter(), PLANTS if kinds is None else kinds
    scenes, parameters = trained.set_up.parameters([scene])
    knee, lab, found = Knee(scenes[0], parameters[0]), laboratory or Laboratory(), {}
    for index, (kind, make) in enumerate(made.items()):
        random = np.random.default_rng([seed, index])
        members = [make(knee, random) for _ in range(plants)]
        rows: list[tuple[Floats, Floats, bool]] = []
        dropped, refused = 0, 0
        for i, (plant, seen) in enumerate(zip(members, run(members), strict=True)):
            if progress is not None:
                progress(kind, i, plants)
            if seen is None:
                dropped += 1
                continue
            motion, measured = lab.recorded(plant.scene, seen, trained.set_up.springs, random)
            try:
                draws, doubts = trained.draws(replace(scene, motion=motion), measured, limits=limits)
            except InputError:
                refused += 1
                continue
            rows.append((truth_of(plant, seen, knee.parameters), draws, bool(doubts)))
        found[kind] = Answers.of(rows, dropped, refused, knee.parameters.asked)
    names = knee.parameters.names[: knee.parameters.asked]
    return Calibration(names, found, trained.sentence(), seed, time.perf_counter() - began)
