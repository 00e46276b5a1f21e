"""Turns the end of a search into its answer: shortens the time steps, weighs priors, and searches once more.

Where contacts begin and end, an objective computed with long steps is rough: it has many local minima, and its
curvature is not that of the motion (on the rig's case 1 steps of 1.7 ms leave jumps of 5 nats). Searches use long steps
nevertheless, since they have far to go. Then steps are halved until the estimate, with the covariance that is reported,
no longer changes; and if there are priors, the measurements are weighed against them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.evaluation import Evaluator
from fitting.methods.least_squares import LeastSquares
from fitting.methods.problem import Method, Problem, State
from fitting.objective import Objective
from fitting.parameters import Parameters
from fitting.trials_evaluator import TrialsEvaluator
from fitting.uncertainty import (
    SERIAL,
    inverse_information,
    long_run_score,
    scaled_by_noise,
    serial_correlation,
    uncertainty,
)
from pftwin.base.arrays import Floats

_MOST = 8  # most steps between two frames, as a multiple of the number before their error has been checked
_SETTLED = 0.05  # divergence [nats] below which two estimates count as equal: a shift by 0.3 SD, or 22 % of one SD
_UNSETTLED = (
    "time steps half as long would still change the values by a third of their standard deviations, or these by a fifth"
)
_BY_BOUNDS = 12.0  # information of a uniform distribution between the bounds, in shares of the range
_WHOLE = 0.95  # shares above this make no visible difference
_OPEN = 1e-10  # share of the largest eigenvalue: directions with less information are not determined


def finished(search: Method, state: State, run: Callable[[Method], State]) -> tuple[Method, State]:
    """A finished search with the time steps and weights that its answer needs, and its state with that answer; `run`
    iterates a method until it stops. A population's search keeps its best parameters unless there are priors."""
    problem = search.problem
    if state["best_theta"] is None or not (search.rough or problem.weighs_priors):
        return search, state
    theta = np.asarray(state["best_theta"])
    try:
        problem = _with_share(problem, theta)
        remaining = shorten_steps(problem.evaluator, lambda n: estimate_at(problem, theta, n)) if search.rough else 0.0
        problem = _with_share(problem, theta)
        resumed = run(LeastSquares(with_nominal(problem, theta), search.seed, near=True))
    except KeyboardInterrupt:  # before there is an answer
        return search, {**state, "interrupted": True}
    if resumed["best_theta"] is None:
        return search, {**state, "stopped": "with shorter steps or reweighted measurements the simulation failed"}
    search.problem = replace(search.problem, objective=problem.objective)
    state = _continued(state, resumed)
    if remaining > _SETTLED:
        state["notes"] = [_UNSETTLED]
    return search, state


def shorten_steps(
    evaluator: Evaluator | TrialsEvaluator,
    estimate: Callable[[int], NormalEstimate | None],
    tolerance: float = _SETTLED,
) -> float:
    """Halves an evaluator's steps until `estimate(substeps)` changes by no more than a tolerance [nats]; stops if it
    returns None, because a simulation failed.

    Returns the remaining change [nats], after the last halving extrapolated: the error of steps is of first order.
    """
    halvings = int(np.log2(_MOST * evaluator.first / evaluator.fine))
    remaining = halving_change(estimate, evaluator.fine)
    while remaining > tolerance and halvings > 0:
        evaluator.fine *= 2
        halvings -= 1
        remaining = halving_change(estimate, evaluator.fine) if halvings else remaining / 4
    return remaining


def halving_change(estimate: Callable[[int], NormalEstimate | None], substeps: int) -> float:
    """Change of the estimate when steps are halved [nats]; 0 if a simulation fails, infinite if one of the two is not
    finite."""
    ours, theirs = (estimate(n) for n in (substeps, 2 * substeps))
    if ours is None or theirs is None:
        return 0.0
    finite = np.isfinite(ours.precision).all() and np.isfinite(theirs.precision).all()
    return ours.divergence(theirs) if finite else np.inf


def _with_share(problem: Problem, theta: Floats) -> Problem:
    """The problem with the share of the likelihood that counts beside priors, if there are any."""
    if not problem.weighs_priors:
        return problem
    return replace(problem, objective=replace(problem.objective, share=share_at(problem, theta)))


def share_of_independent(objective: Objective, r: Floats, j: Floats) -> float:
    """Share of the likelihood with which correlated residuals (n, m), with derivatives (n, m, p), count beside priors,
    for an objective of known noise; 1 without correlation.

    Measurements whose residuals resemble their neighbours' are redundant. Counted as independent they overwhelm the
    priors. Their log likelihood is therefore multiplied by a share w before priors are added, as in power posteriors:
    the inverse of the mean inflation, over the p directions of the parameters, of the score's long-run variance (Newey
    & West 1987) over its variance without correlation. Sources: Bissiri, Holmes & Walker 2016, JRSS B 78:1103
    (general Bayesian updating); Holmes & Walker 2017, Biometrika 104:497 (w by matching information).
    """
    z, a = scaled_by_noise(objective, r, j)
    serial = serial_correlation(z, objective.present)
    if serial <= SERIAL:
        return 1.0
    information = np.einsum("tmp,tmq->pq", a, a)
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    vectors = vectors / size[:, None]
    determined = values > _OPEN * values[-1]
    variances = np.einsum("pi,pq,qi->i", vectors, long_run_score(a, z, serial, objective.frames), vectors)
    return float(min(1.0, 1 / np.mean(variances[determined] / values[determined])))


def share_at(problem: Problem, theta: Floats) -> float:
    """The share w of a problem at the minimum of its quadratic model around parameters (p,); 1 if it is nearly 1."""
    target = problem.objective
    prediction = problem.prediction(theta, problem.evaluator.fine)
    if not prediction.usable[0]:
        return 1.0
    r, j = (a[0] for a in target.linear(prediction))
    r = r + j @ problem.quadratic_step(theta, problem.evaluator.fine)
    share = share_of_independent(target.known(target.noise or target.noise_of(r, len(theta))), r, j)
    return 1.0 if share > _WHOLE else share


class NormalEstimate(NamedTuple):
    """Normal distribution of the requested parameters, in shares of their ranges."""

    mean: Floats  # (d,)
    precision: Floats  # (d, d), including the information in the bounds

    @staticmethod
    def of(mean: Floats, precision: Floats) -> NormalEstimate:
        """Adds the information in the bounds."""
        return NormalEstimate(mean, precision + _BY_BOUNDS * np.eye(len(mean)))

    def divergence(self, other: NormalEstimate) -> float:
        """Kullback-Leibler divergence from another distribution [nats]."""
        ratio = np.linalg.solve(self.precision.T, other.precision.T).T  # its precision times our covariance
        off = self.mean - other.mean
        determinants = np.linalg.slogdet(self.precision)[1] - np.linalg.slogdet(other.precision)[1]
        return float(0.5 * (np.trace(ratio) - len(off) + off @ other.precision @ off + determinants))


def estimate_at(problem: Problem, theta: Floats, substeps: int) -> NormalEstimate | None:
    """The estimate from the quadratic model at these parameters; None if the simulation fails."""
    prediction, target, p = problem.prediction(theta, substeps), problem.objective, problem.parameters
    if not prediction.usable[0]:
        return None
    r, j = (a[0] for a in target.linear(prediction))
    known = target.known(target.noise or target.noise_of(r, len(p)))
    asked, span = slice(p.asked), p.upper - p.lower
    mean = p.share(theta + problem.quadratic_step(theta, substeps))
    covariance = (uncertainty(known, p, r, j, theta).covariance / np.outer(span, span))[asked, asked]
    if not np.linalg.eigvalsh(covariance)[0] > 0:  # derivatives that grow from step to step, or an open combination
        return NormalEstimate(mean[asked], np.full(covariance.shape, np.nan))
    return NormalEstimate.of(mean[asked], inverse_information(covariance))


def with_nominal(problem: Problem, theta: Floats) -> Problem:
    """The problem whose nominal parameters are these (p,)."""
    there = tuple(replace(p, nominal=float(t)) for p, t in zip(problem.parameters.items, theta, strict=True))
    return replace(problem, parameters=Parameters(there))


def _continued(state: State, resumed: State) -> State:
    """The state of a search, continued by another one."""
    before = {key: state[key] for key in ("iteration", "evaluations")}
    later = [{**entry, **{key: entry[key] + count for key, count in before.items()}} for entry in resumed["history"]]
    best = {key: resumed[key] for key in ("best_theta", "best_value", "stopped", "interrupted")}
    counts = {key: before[key] + resumed[key] for key in before}
    return {**state, **best, **counts, "history": [*state["history"], *later]}
