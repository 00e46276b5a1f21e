"""How much correlated residuals count beside priors.

Measurements whose residuals resemble their neighbours' repeat each other. Counted as independent they drown the
priors. Their log likelihood is therefore multiplied by a share w before priors are added, as in power posteriors: the
inverse of the mean inflation, over the p directions of the parameters, of the score's long-run variance (Newey & West
1987) over what it would be without correlation. Sources: Bissiri, Holmes & Walker 2016, JRSS B 78:1103 (general
Bayesian updating); Holmes & Walker 2017, Biometrika 104:497 (w by matching information).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting.methods.least_squares import LeastSquares
from fitting.parameters import Parameters
from fitting.uncertainty import SERIAL, long_run_score, scaled_by_noise, serial_correlation

if TYPE_CHECKING:
    from fitting.methods.problem import Method, Problem, State
    from fitting.objective import Objective

Floats = NDArray[np.float64]

_WHOLE = 0.95  # shares above this change nothing that could be seen
_OPEN = 1e-10  # of the largest eigenvalue: directions with less information are not determined


def share_of_independent(objective: Objective, r: Floats, j: Floats) -> float:
    """w of residuals (n, m) and their derivatives (n, m, p), by an objective of known noise; 1 without correlation."""
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


def reweighed(search: Method, state: State, run: Callable[[Method], State]) -> tuple[Method, State]:
    """The search whose problem counts its measurements by their share, and its state: where it ends, from where it was.

    A problem without priors ends where it was, whatever its measurements count.

    Args:
        search: that has ended.
        state: its.
        run: iterates a method until it stops.
    """
    problem = search.problem
    theta = state["best_theta"]
    if not problem.weighs_priors or theta is None:
        return search, state
    share = _share(problem, np.asarray(theta))
    if share == 1.0 and not search.rough:
        return search, state
    objective = replace(problem.objective, share=share)
    from_there = tuple(replace(p, nominal=float(t)) for p, t in zip(problem.parameters.items, theta, strict=True))
    anew = replace(problem, objective=objective, parameters=Parameters(from_there))
    try:
        again = run(LeastSquares(anew, search.seed, 1))
    except KeyboardInterrupt:  # before it had an answer
        return search, {**state, "interrupted": True}
    if again["best_theta"] is None:
        return search, {**state, "stopped": "with measurements counted anew no motion could be simulated"}
    search.problem = replace(problem, objective=objective)
    before = {key: state[key] for key in ("iteration", "evaluations")}
    later = [{**entry, **{key: entry[key] + count for key, count in before.items()}} for entry in again["history"]]
    best = {key: again[key] for key in ("best_theta", "best_value", "stopped", "interrupted")}
    counts = {key: before[key] + again[key] for key in before}
    return search, {**state, **best, **counts, "history": [*state["history"], *later]}


def _share(problem: Problem, theta: Floats) -> float:
    """Of the measurements at these parameters (p,)."""
    target = problem.objective
    seen = problem.prediction(theta, problem.evaluator.fine)
    if not seen.usable[0] or seen.slopes is None:
        return 1.0
    r = target.residuals(seen.values)[0]
    j = target.slopes(seen.slopes, seen.values)[0]
    share = share_of_independent(target.known(target.noise or target.noise_of(r, len(theta))), r, j)
    return 1.0 if share > _WHOLE else share
