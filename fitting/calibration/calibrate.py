"""`calibrate`: measures the coverage of intervals on plants, synthetic knees that the twin does not know."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fitting.calibration.laboratory import Laboratory
from fitting.calibration.operations import OUTCOMES, Operation, OperationOutcome
from fitting.calibration.plants import PLANTS, Knee, Maker, Plant, PlantMotion, check_truth, simulate_plants, truth_of
from fitting.calibration.quick_fit import interval_draws
from fitting.calibration.result import Answers, Calibration, Plans
from fitting.channel_checks import limits_of
from fitting.estimate import Estimate
from fitting.nuisance import EXACT, Nuisance
from fitting.parameters import Parameter, Parameters
from fitting.programs import reading_units
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene, check

if TYPE_CHECKING:
    from fitting.calibration.quick_fit import QuickFit
    from fitting.set_up import SetUp
    from fitting.trained import TrainedPosterior

PER_KIND = 100  # plants
MISPLACED = Nuisance(attachments=1e-3, damping=0.5)  # model errors of plants for twins that are taken as exact
_OWN_STREAM = 7  # of random numbers, different from that of a training with the same seed


def calibrate(
    trained: TrainedPosterior | QuickFit,
    scene: Scene | Sequence[Scene],
    *,
    plants: int = PER_KIND,
    kinds: Mapping[str, Maker] | None = None,
    laboratory: Laboratory | None = None,
    operation: Operation | None = None,
    seed: int = 0,
    limits: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Calibration:
    """Simulates and records plants of several kinds, and fits each recording.

    Args:
        trained: a trained posterior, or a `fitting.QuickFit`, which searches anew for each plant.
        scene: scene of its set-up, or those of its trials; plants move in their motions.
        plants: number of each kind.
        kinds: functions that make a plant, by name; by default `fitting.calibration.plants.PLANTS`.
        laboratory: how plants are recorded; by default as on the virtual rig.
        operation: treatment whose outcomes are predicted from each answer and compared with those of the treated plant,
            in the first trial. Answers are then checked as in `TrainedPosterior.estimate`.
        seed: of all random choices.
        limits: as in `TrainedPosterior.estimate`.
        progress: called with the kind of plant, the number of them that were answered, and of all.

    Raises:
        InputError: no plants, or no kind of them; a kind that this scene cannot have; another number of trials or
            frames than in training; a recording too short for the laboratory's filter; a reading that the laboratory
            does not record, or no effect reports; an operation that this knee cannot have.
    """
    if not isinstance(plants, int) or plants < 1:
        raise InputError(f"found {plants!r}", where="plants", expected="a whole number, at least 1")
    began, made = time.perf_counter(), PLANTS if kinds is None else kinds
    if not made:
        raise InputError("no kind of plants", where="kinds", expected=f"some of: {', '.join(PLANTS)}; or functions")
    limits_of(limits)
    scenes, lab = [scene] if isinstance(scene, Scene) else list(scene), laboratory or Laboratory()
    _check_scenes(scenes, trained.set_up, operation, lab)
    knees, parameters = _knees(trained.set_up, scenes)
    calibrator = _Calibrator(trained, knees, parameters.items, lab, scenes, operation, limits)
    found: dict[str, Answers] = {}
    optional: dict[str, dict[str, Any]] = {"predictions": {}, "plans": {}}
    for index, (kind, make) in enumerate(made.items()):
        random = np.random.default_rng([seed, index, _OWN_STREAM])
        members = [plant_in_trials(make, knees, random) for _ in range(plants)]
        found[kind], operations = calibrator.answers(members, random, partial(progress, kind) if progress else None)
        if operation is not None:
            optional["predictions"][kind] = Answers.of_predictions(operations, OUTCOMES)
        if operation is not None and operation.limits:
            optional["plans"][kind] = Plans.of(operations, operation.confidence)
    names = parameters.names[: parameters.asked]
    words = operation.describe() if operation is not None else ""
    return Calibration(names, found, trained.sentence(), seed, time.perf_counter() - began, words, **optional)


def _check_scenes(scenes: list[Scene], set_up: SetUp, operation: Operation | None, lab: Laboratory) -> None:
    """Raises InputError for scenes that are not of the set-up, cannot have the operation, or are not fully recorded."""
    for one in scenes:
        check(one)
    set_up.check_frames(scenes, scenes[0].name)
    if operation is not None:
        operation.check(scenes[0])
    recorded = reading_units(scenes[0], [*set_up.channels, *lab.readings])
    if missing := [name for name in recorded if name not in lab.readings]:
        remedy = f"Laboratory(readings={{{missing[0]!r}: ...}}), the standard deviation of its noise"
        raise InputError(f"{missing[0]} is not recorded", where="laboratory", remedy=remedy)


def _knees(set_up: SetUp, scenes: Sequence[Scene]) -> tuple[list[Knee], Parameters]:
    """The knee of every trial, and the first trial's parameters, including differences between trials."""
    prepared, parameters = set_up.parameters(scenes)
    knees = [Knee(one, own.shared, tuple(prepared)) for one, own in zip(prepared, parameters, strict=True)]
    if set_up.nuisance == EXACT:
        wider = zip(*set_up._replace(nuisance=MISPLACED).parameters(scenes), strict=True)
        knees = [replace(knee, lacking=(one, own.shared)) for knee, (one, own) in zip(knees, wider, strict=True)]
    return knees, parameters[0]


def plant_in_trials(make: Maker, knees: Sequence[Knee], random: np.random.Generator) -> list[Plant]:
    """One plant in every trial: the same random numbers make it the same in all."""
    others = [make(knee, deepcopy(random)) for knee in knees[1:]]
    return [make(knees[0], random), *others]


def with_differences(plant: Sequence[Plant], items: Sequence[Parameter], random: np.random.Generator) -> list[Plant]:
    """The plant in each of these trials, with differences between trials drawn from their priors."""
    found = list(plant)
    for p in items:
        if p.trial is not None and p.trial < len(found) and p.prior is not None:
            one, drawn = found[p.trial], np.clip(random.normal(*p.prior), p.lower, p.upper)
            found[p.trial] = one._replace(scene=p.place.written(one.scene, p.place.read(one.scene) + float(drawn)))
    return found


class _Calibrator(NamedTuple):
    """Records plants and has them answered; lists hold one item per trial."""

    trained: TrainedPosterior | QuickFit
    knees: list[Knee]
    items: tuple[Parameter, ...]  # all free parameters, including differences between trials
    lab: Laboratory
    scenes: list[Scene]
    operation: Operation | None
    limits: Mapping[str, tuple[float, float]] | None

    def answers(
        self, plants: list[list[Plant]], random: np.random.Generator, progress: Callable[[int, int], None] | None
    ) -> tuple[Answers, list[OperationOutcome]]:
        """Answers for plants of one kind, in every trial, and predictions for those answered without a doubt."""
        parameters = self.knees[0].parameters
        check_truth(plants[0][0], parameters)
        rows: list[tuple[Floats, Floats, bool]] = []
        dropped, refused, operations = 0, 0, []
        differing = [with_differences(plant, self.items, random) for plant in plants]
        simulated = zip(*(simulate_plants(in_one) for in_one in zip(*differing, strict=True)), strict=True)
        for i, (plant, own, each) in enumerate(zip(plants, differing, simulated, strict=True)):
            if progress is not None:
                progress(i, len(plants))
            motions = [one for one in each if one is not None]
            if len(motions) < len(each):
                dropped += 1
                continue
            recorded, measured = self._recorded(own, motions, random)
            try:
                draws, doubts, estimate = self._answer(recorded, measured)
            except PftwinError:  # of this recording; the caller's errors have been raised before
                refused += 1
                continue
            truth = truth_of(plant[0], motions, parameters, own if self.trained.set_up.varies else None)
            rows.append((truth, draws, bool(doubts)))
            if self.operation is not None and estimate is not None and not doubts:
                (further,) = with_differences(plant[:1], self.items, random)  # predictions are of a further trial
                operations.append(self.operation.on(further.scene, recorded[0], estimate))
        return Answers.of(rows, dropped, refused, parameters.asked), operations

    def _recorded(
        self, plant: list[Plant], motions: list[PlantMotion], random: np.random.Generator
    ) -> tuple[list[Scene], list[Measured]]:
        """The nominal knee in the recorded motion of every trial, and what was measured."""
        springs, constant = self.trained.set_up.springs, random.spawn(1)[0]
        each = [
            self.lab.recorded(one.scene, true_motion, springs, random, deepcopy(constant), first=k == 0)
            for k, (one, true_motion) in enumerate(zip(plant, motions, strict=True))
        ]
        scenes = [replace(scene, motion=motion) for scene, (motion, _) in zip(self.scenes, each, strict=True)]
        return scenes, [measured for _, measured in each]

    def _answer(self, recorded: list[Scene], measured: list[Measured]) -> tuple[Floats, Sequence[str], Estimate | None]:
        """Draws of the requested parameters, doubts, and, if something is to be predicted, the whole estimate."""
        if self.operation is None:
            return *self.trained.draws(recorded, measured, limits=self.limits), None
        estimate = self.trained.estimate(recorded, measured, limits=self.limits)
        return interval_draws(estimate), estimate.doubts, estimate
