"""Infers the posterior of a scene's parameters from simulated recordings, in rounds.

1. Parameters are drawn from their priors (requested ones uniformly within their bounds), including nuisance, and
   simulated as recordings: motions with noise like the part of the measurements that simulations do not explain.
2. Networks learn the posterior of the requested parameters from summaries of these recordings
   (`fitting.inference.network`); nuisance, given those, follows from a linear model
   (`fitting.inference.nuisance_draws`).
3. The next round draws from where this posterior lies (`fitting.inference.region`), until it no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fitting.evaluation import HALVINGS, Prediction
from fitting.inference.learning import Answer, Learned, learn
from fitting.inference.nuisance_draws import with_nuisance
from fitting.inference.recordings import Noise
from fitting.inference.region import Region
from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.parameters import Parameters
from fitting.sensors import sensed
from pftwin.base.errors import InputError

PER_ROUND = 8000  # simulations
TOGETHER = 64  # simulations that two cores run in two calls of 32; 128 per call takes as long, and compiles twice
ROUNDS = 6  # at most
DRAWS = 2000  # of the posterior
_MOST_ASKED = 12  # requested parameters
_MOST_STEPS = 8  # most steps between two frames, as a multiple of the number before their error has been checked
_MOVED = 0.15  # largest shift of the posterior's mean, in its SD, when steps are halved: in all at most twice that
_SETTLED = 0.35  # largest change of the region's mean log half width, and of its centre in SD, that counts as none
_FEWEST_USABLE = 0.2  # least share of simulations that must run
_FEWEST_SIMULATIONS = 1000
MOST_NUMBERS = 100_000_000  # values of all recordings of a round, which are held in memory


class Inferred(NamedTuple):
    """The last round's posterior, and how it was obtained."""

    answer: Answer
    noise: Noise  # noise of the simulated recordings
    simulations: int  # of all rounds
    dropped: int  # of these, without an equilibrium or a finite motion
    substeps: int
    history: list[dict[str, float]]
    reason: str
    interrupted: bool = False


def check_size(parameters: Parameters, simulations: int, numbers: int) -> None:
    """Checks the size of a problem; `numbers` is the number of values of a recording. Raises InputError for too many
    requested parameters, too few simulations, or more than fit in memory."""
    if (asked := parameters.asked) > _MOST_ASKED:
        found = f"{asked} parameters beside nuisance"
        raise InputError(found, where="free", expected=f"at most {_MOST_ASKED} for simulations")
    if simulations < _FEWEST_SIMULATIONS:
        raise InputError(f"found {simulations}", where="simulations", expected=f"at least {_FEWEST_SIMULATIONS}")
    if simulations * numbers > MOST_NUMBERS:
        found = f"{simulations:,} recordings of {numbers:,} numbers"
        expected = f"at most {MOST_NUMBERS // numbers:,} simulations of this recording"
        raise InputError(found, where="simulations", expected=expected, remedy="fewer simulations, or fewer frames")


def check_enough(usable: int, simulations: int, problem: Problem) -> None:
    """Raises InputError if too few of the simulations found an equilibrium and a finite motion to learn from."""
    if usable < max(_FEWEST_USABLE * simulations, min(simulations, _FEWEST_SIMULATIONS) / 2):
        raise InputError(
            f"{simulations - usable} of {simulations} simulations found no equilibrium or no finite motion",
            where=problem.scene.name,
            remedy="narrower bounds, or a scene that `pftwin simulate` can run",
        )


def infer(
    problem: Problem,
    nuisance: Nuisance,
    seed: int,
    simulations: int,
    rounds: int,
    report: Callable[[dict[str, float], int], None],
) -> Inferred:
    """Infers the posterior of a problem's parameters, in at most `rounds` rounds of `simulations`.

    Noise that the objective states is taken as known; recordings also have sensor errors. `report` is called with each
    round's entry of the history (its spread is the posterior's, as a share of the bounds) and the number of rounds.
    Raises InputError if too few simulations can be run, and PftwinError if the learned posterior lies beyond the
    bounds.
    """
    whole = region = Region(problem.parameters)
    noise = Noise.initial(problem.objective)
    substeps, dropped, found = problem.evaluator.first, 0, None
    history: list[dict[str, float]] = []
    try:
        for number in range(rounds):
            random = np.random.default_rng([seed, number])
            learned, answer, lost, best = _round(problem, nuisance, region, noise, substeps, simulations, random)
            dropped, smaller = dropped + lost, whole.around(answer.draws)
            best = min(best, history[-1]["best"]) if history else best
            entry = {"iteration": number + 1, "evaluations": (number + 1) * simulations, "best": best}
            history.append({**entry, "spread": float(np.exp(smaller.size - region.widest))})
            needed = _steps_needed(problem, learned, answer, substeps, [seed, number])
            settled = smaller.like(region, _SETTLED) and (needed == substeps or problem.objective.noise is None)
            reason = "the posterior no longer changes" if settled else f"still changing after round {number + 1}"
            found = Inferred(answer, learned.noise, (number + 1) * simulations, dropped, substeps, history, reason)
            report(history[-1], rounds)
            if settled:
                break
            region, noise, substeps = smaller, learned.noise, needed
    except KeyboardInterrupt:
        if found is None:
            raise
        found = found._replace(reason="interrupted; the last whole round", interrupted=True)
    assert found is not None
    return found


def _steps_needed(problem: Problem, learned: Learned, answer: Answer, substeps: int, seed: list[int]) -> int:
    """Steps between two frames that the next round needs, so that halving them would not move the posterior.

    If the noise is not stated but estimated from what simulations leave unexplained, it includes the error of their
    steps. The steps are then halved once per round, while the motion's error exceeds the limit for answers.
    """
    evaluator, there = problem.evaluator, answer.draws.mean(axis=0)
    if problem.objective.noise is None:
        errors = evaluator.step_errors(there, substeps, slopes=False)
        large = any(e.large for e in errors.values())
        return 2 * substeps if large and substeps < evaluator.first << HALVINGS else substeps
    while substeps < _MOST_STEPS * evaluator.first:
        runs = [evaluator.values(there[None], n) for n in (substeps, 2 * substeps)]
        if not all(run.usable[0] for run in runs):
            break
        residuals = (problem.objective.residuals(run.values)[0].astype(np.float32) for run in runs)
        long, short = (learned.answer(each, DRAWS, np.random.default_rng(seed)).draws for each in residuals)
        if (np.abs(short.mean(axis=0) - long.mean(axis=0)) <= _MOVED * long.std(axis=0)).all():
            break
        substeps *= 2
    return substeps


def _round(
    problem: Problem,
    nuisance: Nuisance,
    region: Region,
    noise: Noise,
    substeps: int,
    simulations: int,
    random: np.random.Generator,
) -> tuple[Learned, Answer, int, float]:
    """One round's posterior, number of simulations without equilibrium or finite motion, and their least objective."""
    theta = region.drawn(simulations, random)
    predictions = problem.evaluator.values(theta, substeps)
    theta, values = theta[predictions.usable], predictions.values[predictions.usable]
    check_enough(len(theta), simulations, problem)
    recordings = problem.objective.residuals(sensed(values, nuisance, problem, random)).astype(np.float32)
    nothing = np.zeros_like(recordings[0])  # the measurements, relative to themselves
    learned = learn(region, theta, recordings, nothing, problem.objective, noise, random)
    cost = problem.objective.value(Prediction(values, None, np.ones(len(values), bool)))
    best = float(np.min(cost + problem.parameters.prior_terms(theta)[0]))
    answer = learned.answer(nothing, DRAWS, random)
    draws = with_nuisance(problem, nuisance, problem.objective, learned, nothing, answer.draws, substeps, random)
    return learned, answer._replace(draws=draws), simulations - len(theta), best
