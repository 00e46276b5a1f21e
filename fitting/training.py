"""`train_posterior`: trains networks on simulations of a set-up once, to answer each of its recordings in seconds.

This is the first round of `fit_tendons(method="simulations")`, with more simulations, for any recording of the set-up
instead of one. So its intervals are wider than those of later rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fitting.channel_checks import limits_of
from fitting.first_look import check_by_differences
from fitting.fit import SPRING_PARAMETERS
from fitting.inference.infer import MOST_NUMBERS, TOGETHER, check_enough, check_size
from fitting.inference.learning import learn
from fitting.inference.recordings import Noise
from fitting.inference.region import Region
from fitting.methods.problem import Problem
from fitting.metric import StatedNoise
from fitting.nuisance import Nuisance
from fitting.objective import SPRINGS, Objective
from fitting.parameters import Bounds
from fitting.programs import POSITION
from fitting.sensors import sensed
from fitting.set_up import SetUp, from_nominal, refuse_weights, relative_measurements
from fitting.trained import Probes, TrainedPosterior
from fitting.trials import free_in_trials, objective_of, trials_of
from pftwin.base.arrays import Floats, Rows
from pftwin.dynamics.batch.devices import Devices
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

AT_ALL = 30_000  # simulations by default
_AT_ONCE = 2048  # simulations between two reports of progress
_PROBES = 24  # knees that are simulated again in the set-up of each recording


def train_posterior(
    scene: Scene | Sequence[Scene],
    measured: Measured | Sequence[Measured | None] | None = None,
    *,
    free: Sequence[str] = SPRING_PARAMETERS,
    bounds: Bounds = 0.3,
    priors: Mapping[str, tuple[float, float]] | None = None,
    nuisance: str | Nuisance | None = None,
    varies: Mapping[str, float] | None = None,
    seed: int = 0,
    use: str | Sequence[str] = POSITION,
    noise: StatedNoise | None = None,
    springs: Mapping[str, str] = SPRINGS,
    simulations: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    devices: Devices = "all",
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> TrainedPosterior:
    """Trains a posterior that answers every recording of a set-up.

    Args:
        scene: the nominal scene with the motion of a first recording; or the scenes of several trials of one knee.
        measured: the first recording, from which noise that is not stated is estimated; by default the scene's.
        free: as in `fit_tendons`, like `bounds`, `priors`, `nuisance`, `varies`, `seed`, `use`, `noise`, `springs`,
            `devices` and `limits`.
        simulations: number of simulated recordings; by default 30,000, or fewer if memory would not suffice.
        progress: called with the number of simulations that have run, and of all.

    Raises:
        InputError: as `fit_tendons(method="simulations")`; if too many frames of a channel are missing; if frames have
            weights, which every recording would need to share.
    """
    began, allowed, extra = time.perf_counter(), limits_of(limits), Nuisance.of(nuisance)
    nominal, given = trials_of(scene, measured)
    refuse_weights(given)
    extra = extra.at_work(nominal)
    scenes, parameters = free_in_trials(nominal, free, bounds, priors, extra, varies)
    target = objective_of(scenes, given, "likelihood", use, noise, "linear", springs)
    problem = Problem.of(scenes, parameters, target, devices=devices)
    numbers = target.present.size
    simulations = min(AT_ALL, MOST_NUMBERS // numbers) if simulations is None else simulations
    check_size(problem.parameters, simulations, numbers)
    problem.evaluator.prepare(TOGETHER)
    doubts = check_by_differences(problem, allowed)
    substeps = problem.evaluator.short_enough(slopes=False)
    random, region = np.random.default_rng(seed), Region(problem.parameters)
    probed = region.drawn(_PROBES, random)
    held, prediction = from_nominal(problem, substeps, probed)
    probes = Probes(probed[prediction.usable], held.residuals(prediction.values[prediction.usable]).astype(np.float32))
    check_enough(len(probes.theta), _PROBES, problem)
    first = relative_measurements(problem, held, held.present)
    drawn = region.drawn(simulations, random)
    theta, recordings = _simulated(problem, held, extra, drawn, substeps, random, progress)
    check_enough(len(theta), simulations, problem)
    learned = learn(region, theta, recordings, first, held, Noise.initial(target), random)
    own = SetUp.of(problem, extra, springs), learned, probes, held.present, substeps
    counts = simulations, simulations - len(theta)
    return TrainedPosterior(*own, *counts, seed, time.perf_counter() - began, doubts=tuple(doubts))


def _simulated(
    problem: Problem,
    held: Objective,
    nuisance: Nuisance,
    theta: Floats,
    substeps: int,
    random: np.random.Generator,
    progress: Callable[[int, int], None] | None,
) -> tuple[Floats, Rows]:
    """Those of the parameters (N, p) that could be simulated, and their recordings (N, n, m) relative to the nominal
    one, without noise but with sensor errors drawn for each."""
    usable, recordings = [], []
    for i in range(0, len(theta), _AT_ONCE):
        part = theta[i : i + _AT_ONCE]
        prediction = problem.evaluator.values(part, substeps)
        usable.append(part[prediction.usable])
        read = sensed(prediction.values[prediction.usable], nuisance, problem, random)
        recordings.append(held.residuals(read).astype(np.float32))
        if progress is not None:
            progress(i + len(part), len(theta))
    return np.concatenate(usable), np.concatenate(recordings)
