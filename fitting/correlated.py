"""How much correlated residuals count beside priors.

Measurements whose residuals resemble their neighbours' repeat each other. Counted as independent they drown the
priors. Their log likelihood is therefore multiplied by a share w before priors are added, as in power posteriors: the
inverse of the mean inflation, over the p directions of the parameters, of the score's long-run variance (Newey & West
1987) over what it would be without correlation. Sources: Bissiri, Holmes & Walker 2016, JRSS B 78:1103 (general
Bayesian updating); Holmes & Walker 2017, Biometrika 104:497 (w by matching information).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.uncertainty import SERIAL, long_run_score, scaled_by_noise, serial_correlation
from pftwin.base.arrays import Floats

if TYPE_CHECKING:
    from fitting.methods.problem import Problem
    from fitting.objective import Objective


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


def share_at(problem: Problem, theta: Floats) -> float:
    """w of a problem's measurements at the least of its quadratic model at parameters (p,); 1 where it is nearly 1."""
    target = problem.objective
    seen = problem.prediction(theta, problem.evaluator.fine)
    if not seen.usable[0] or seen.slopes is None:
        return 1.0
    j = target.slopes(seen.slopes, seen.values)[0]
    r = target.residuals(seen.values)[0] + j @ problem.ahead(theta, problem.evaluator.fine)
    share = share_of_independent(target.known(target.noise or target.noise_of(r, len(theta))), r, j)
    return 1.0 if share > _WHOLE else share
