"""From where a search ended to its answer: steps that are short enough, and one more search from there.

Where contacts begin and end, an objective computed in long steps is rough: it has many lowest places near one another,
and its curvature is not that of the motion (on the rig's case 1 steps of 1.7 ms leave jumps of 5 nats). Searches use
long steps nevertheless, for they have far to go. Then steps are halved until the estimate, with the covariance that is
reported, no longer changes; and where there are priors, the measurements are weighed against them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fitting.methods.least_squares import LeastSquares
from fitting.parameters import Parameters
from fitting.uncertainty import (
    SERIAL,
    inverse_information,
    long_run_score,
    scaled_by_noise,
    serial_correlation,
    uncertainty,
)
from pftwin.base.arrays import Floats

if TYPE_CHECKING:
    from fitting.evaluation import Evaluator
    from fitting.methods.problem import Method, Problem, State
    from fitting.objective import Objective
    from fitting.trials_evaluator import TrialsEvaluator


_MOST = 8  # times as many steps as before anything is known of their errors, at most
_SETTLED = 0.05  # divergence [nats] of two estimates that are taken for one: a shift by 0.3 deviations, or 22 % of one
_UNSETTLED = (
    "time steps half as long would still change the values by a third of their standard deviations, or these by a fifth"
)
_BY_BOUNDS = 12.0  # information of an even distribution between bounds, by shares of the range
_WHOLE = 0.95  # shares above this change nothing that could be seen
_OPEN = 1e-10  # of the largest eigenvalue: directions with less information are not determined


def finished(search: Method, state: State, run: Callable[[Method], State]) -> tuple[Method, State]:
    """A search that has ended, with the steps and weights that its answer needs, and its state with that answer; `run`
    iterates a method until it stops. A search by a population ends where it was, unless there are priors."""
    problem = search.problem
    if state["best_theta"] is None or not (search.rough or problem.weighs_priors):
        return search, state
    theta = np.asarray(state["best_theta"])
    try:
        problem = _weighed(problem, theta)
        left = settle(problem.evaluator, lambda n: told_at(problem, theta, n)) if search.rough else 0.0
        problem = _weighed(problem, theta)
        again = run(LeastSquares(started_at(problem, theta), search.seed, near=True))
    except KeyboardInterrupt:  # before it had an answer
        return search, {**state, "interrupted": True}
    if again["best_theta"] is None:
        return search, {**state, "stopped": "with shorter steps, or measurements counted anew, nothing could be run"}
    search.problem = replace(search.problem, objective=problem.objective)
    state = _joined(state, again)
    if left > _SETTLED:
        state["notes"] = [_UNSETTLED]
    return search, state


def settle(
    evaluator: Evaluator | TrialsEvaluator, told: Callable[[int], Told | None], tolerance: float = _SETTLED
) -> float:
    """Halves the steps of an evaluator's answers until what is `told` with so many between two frames (None where no
    motion comes out, which ends it) changes by no more than a tolerance [nats].

    Returns by how much it would still change [nats]: from the last halving, for the error of steps is of first order.
    """
    left, halvings = change(told, evaluator.fine), int(np.log2(_MOST * evaluator.first / evaluator.fine))
    while left > tolerance and halvings > 0:
        evaluator.fine *= 2
        halvings -= 1
        left = change(told, evaluator.fine) if halvings else left / 4
    return left


def change(told: Callable[[int], Told | None], substeps: int) -> float:
    """By how much what is told changes in half the steps [nats]; 0 where no motion comes out there, infinite where
    one of the two is none."""
    ours, theirs = (told(n) for n in (substeps, 2 * substeps))
    if ours is None or theirs is None:
        return 0.0
    finite = np.isfinite(ours.precision).all() and np.isfinite(theirs.precision).all()
    return ours.divergence(theirs) if finite else np.inf


def _weighed(problem: Problem, theta: Floats) -> Problem:
    """With what its measurements count beside priors, if there are any."""
    if not problem.weighs_priors:
        return problem
    return replace(problem, objective=replace(problem.objective, share=share_at(problem, theta)))


def share_of_independent(objective: Objective, r: Floats, j: Floats) -> float:
    """How much correlated residuals (n, m), with derivatives (n, m, p), count beside priors, by an objective of known
    noise: 1 without correlation.

    Measurements whose residuals resemble their neighbours' repeat each other. Counted as independent they drown the
    priors. Their log likelihood is therefore multiplied by a share w before priors are added, as in power posteriors:
    the inverse of the mean inflation, over the p directions of the parameters, of the score's long-run variance (Newey
    & West 1987) over what it would be without correlation. Sources: Bissiri, Holmes & Walker 2016, JRSS B 78:1103
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
    told = values > _OPEN * values[-1]
    spread = np.einsum("pi,pq,qi->i", vectors, long_run_score(a, z, serial, objective.frames), vectors)
    return float(min(1.0, 1 / np.mean(spread[told] / values[told])))


def share_at(problem: Problem, theta: Floats) -> float:
    """w of a problem's measurements at the least of its quadratic model at parameters (p,); 1 where it is nearly 1."""
    target = problem.objective
    seen = problem.prediction(theta, problem.evaluator.fine)
    if not seen.usable[0]:
        return 1.0
    r, j = (a[0] for a in target.linear(seen))
    r = r + j @ problem.ahead(theta, problem.evaluator.fine)
    share = share_of_independent(target.known(target.noise or target.noise_of(r, len(theta))), r, j)
    return 1.0 if share > _WHOLE else share


class Told(NamedTuple):
    """What is told of the parameters asked for, by shares of their ranges: a normal distribution."""

    mean: Floats  # (d,)
    precision: Floats  # (d, d), with what the bounds tell

    @staticmethod
    def of(mean: Floats, precision: Floats) -> Told:
        """With what the bounds tell besides."""
        return Told(mean, precision + _BY_BOUNDS * np.eye(len(mean)))

    def divergence(self, other: Told) -> float:
        """From another one (Kullback and Leibler) [nats]."""
        spread = np.linalg.solve(self.precision.T, other.precision.T).T  # its precision times our covariance
        off = self.mean - other.mean
        determinants = np.linalg.slogdet(self.precision)[1] - np.linalg.slogdet(other.precision)[1]
        return float(0.5 * (np.trace(spread) - len(off) + off @ other.precision @ off + determinants))


def told_at(problem: Problem, theta: Floats, substeps: int) -> Told | None:
    """By the quadratic model at these parameters; None where no motion comes out."""
    seen, target, p = problem.prediction(theta, substeps), problem.objective, problem.parameters
    if not seen.usable[0]:
        return None
    r, j = (a[0] for a in target.linear(seen))
    known = target.known(target.noise or target.noise_of(r, len(p)))
    asked, span = slice(p.asked), p.upper - p.lower
    mean = p.share(theta + problem.ahead(theta, substeps))
    covariance = (uncertainty(known, p, r, j, theta).covariance / np.outer(span, span))[asked, asked]
    if not np.linalg.eigvalsh(covariance)[0] > 0:  # derivatives that grew from step to step, or an open combination
        return Told(mean[asked], np.full(covariance.shape, np.nan))
    return Told.of(mean[asked], inverse_information(covariance))


def started_at(problem: Problem, theta: Floats) -> Problem:
    """The problem whose nominal parameters are these (p,)."""
    there = tuple(replace(p, nominal=float(t)) for p, t in zip(problem.parameters.items, theta, strict=True))
    return replace(problem, parameters=Parameters(there))


def _joined(state: State, again: State) -> State:
    """The state of a search, and of another one that went on from there."""
    before = {key: state[key] for key in ("iteration", "evaluations")}
    later = [{**entry, **{key: entry[key] + count for key, count in before.items()}} for entry in again["history"]]
    best = {key: again[key] for key in ("best_theta", "best_value", "stopped", "interrupted")}
    counts = {key: before[key] + again[key] for key in before}
    return {**state, **best, **counts, "history": [*state["history"], *later]}
