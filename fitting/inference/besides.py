"""Nuisance of a posterior, given what is asked for: by knees that are simulated where the posterior lies.

Summaries x of a recording are nearly linear in all parameters there. With what is asked for, u, given, nuisance z with
a normal prior is then normal too:

    x = a + A u + B z + e,    cov(e) = C,    z ~ N(m, V)
    precision of z:  B' C^-1 B + V^-1,    mean:  its inverse times  B' C^-1 (x - a - A u) + V^-1 m

C is what noise and errors of sensors do to summaries, and what the straight model leaves of the simulated ones.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.inference.learning import Learned, Rows
from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.objective import Objective
from fitting.parameters import Parameters
from fitting.sensors import sensed
from fitting.stiffening import working_of
from pftwin.base.arrays import Floats
from pftwin.base.errors import PftwinError

_TIMES = 3  # from the prior on, each time where the one before put it
_KNEES, _PER_PARAMETER = 192, 6  # simulated each time, at least, and so many times the number of parameters
_TRIES = 100  # of drawing within the bounds
_OF_SPRINGS = ("stiffness", "slack_length", "stiffening")  # of a tendon that stiffens
_ALIKE = 1e-9  # spread of knees' numbers, as a share of their mean, that is rounding


def with_nuisance(
    problem: Problem,
    nuisance: Nuisance,
    held: Objective,
    learned: Learned,
    recording: Rows,
    asked: Floats,
    substeps: int,
    random: np.random.Generator,
) -> Floats:
    """Draws (N, p) of all parameters of a problem, from draws (N, d) of what is asked for.

    `recording` (n, m) is from what recordings are `held` against; what was `learned` tells summaries and noise. Where
    too few of the knees run to fit a straight model, nuisance is as it was the time before, at first from its prior.
    """
    parameters, d = problem.parameters, asked.shape[1]
    if len(parameters) == d:
        return asked
    draws = np.concatenate([asked, parameters.scattered(len(asked), random)[:, d:]], axis=1)
    for _ in range(_TIMES):
        some = draws[: max(_KNEES, _PER_PARAMETER * len(parameters))]
        seen = problem.evaluator.values(some, substeps)
        freedom = int(seen.usable.sum()) - len(parameters) - 1
        if freedom < 1.2 * learned.middle.size:  # too few to tell what they scatter by
            break
        values = seen.values[seen.usable]
        x = learned.seen(held.residuals(values).astype(np.float32))
        misread = learned.seen(held.residuals(sensed(values, nuisance, problem, random)).astype(np.float32)) - x
        straight = _Straight.of(some[seen.usable], x, misread, learned.added.root)
        mean, root = straight.given(learned.seen(recording[None])[0], asked, parameters)
        draws = np.concatenate([asked, _within(mean, root, parameters, random)], axis=1)
    return draws


class _Straight(NamedTuple):
    """Summaries, whitened, as a straight function of all parameters."""

    center: Floats  # (p,)
    at: Floats  # (k,) summaries there
    slopes: Floats  # (k, p)
    whitening: Floats  # (k, k)

    @staticmethod
    def of(theta: Floats, x: Floats, misread: Floats, noise_root: Floats) -> _Straight:
        """Through summaries (N, k) of simulated knees (N, p), and by how much (N, k) their sensors change them."""
        center, at, spread = theta.mean(axis=0), x.mean(axis=0), theta.std(axis=0)
        scale = np.where(spread > _ALIKE * np.abs(center), spread, np.inf)  # knees that are alike in it tell nothing
        t = (theta - center) / scale
        slopes = np.linalg.lstsq(t, x - at, rcond=None)[0]
        left = x - at - t @ slopes
        # The inverse of a covariance from few knees is too large by freedom / (freedom - k - 1) in the mean.
        covariance = noise_root @ noise_root.T + left.T @ left / (len(x) - t.shape[1] - 2 - x.shape[1])
        covariance += misread.T @ misread / len(x)
        values, vectors = np.linalg.eigh(covariance)
        whitening = (vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
        return _Straight(center, whitening @ at, whitening @ slopes.T / scale, whitening)

    def given(self, x: Floats, asked: Floats, parameters: Parameters) -> tuple[Floats, Floats]:
        """Means (N, q) of nuisance given a recording's summaries (k,) and what is asked for (N, d), and the root (q, q)
        of its covariance."""
        d = asked.shape[1]
        priors = [p.prior or (0.5 * (p.lower + p.upper), p.upper - p.lower) for p in parameters.items[d:]]
        prior, sd = np.array(priors).T
        b = self.slopes[:, d:] * sd  # of nuisance in its prior's deviations
        left = self.whitening @ x - self.at - (asked - self.center[:d]) @ self.slopes[:, :d].T
        middle = (self.center[d:] - prior) / sd
        precision = b.T @ b + np.eye(len(sd))
        mean = np.linalg.solve(precision, b.T @ (left + b @ middle).T).T
        root = np.linalg.inv(np.linalg.cholesky(precision)).T
        return prior + sd * mean, sd[:, None] * root


def _within(mean: Floats, root: Floats, parameters: Parameters, random: np.random.Generator) -> Floats:
    """Normal draws (N, q) about means; rows beyond the bounds are drawn again, and in the end moved to them."""
    d = len(parameters) - mean.shape[1]
    lower, upper = parameters.lower[d:], parameters.upper[d:]
    drawn = mean + random.standard_normal(mean.shape) @ root.T
    for _ in range(_TRIES):
        beyond = np.flatnonzero(((drawn < lower) | (drawn > upper)).any(axis=1))
        if not beyond.size:
            break
        drawn[beyond] = mean[beyond] + random.standard_normal((beyond.size, mean.shape[1])) @ root.T
    return np.clip(drawn, lower, upper)


def at_own_lengths(problem: Problem, besides: Nuisance, draws: Floats) -> tuple[Nuisance, Floats]:
    """Draws (N, p), and nuisance, with the lengths at which tendons work in the motions of the draws' mean.

    Springs that stiffen are learned from as lines over the lengths at which the nominal knee's tendons work, which are
    the same for all simulations. What a laboratory finds with a load cell is the line over what occurred. Draws are
    told by it: their springs stay what they are. Tendons of which stiffness, slack length and stiffening are not all
    free are left as they are, those of which one differs between trials, and those that would hang slack in some draw;
    so are all where that motion cannot be simulated, which is told where the fit is judged.
    """
    parameters = problem.parameters
    vary = {parameters.items[at].place for at, _ in parameters.differences}
    columns = {p.place.name: i for i, p in enumerate(parameters.items) if p.place not in vary}
    numbers = {name: [f"{name}.{number}" for number in _OF_SPRINGS] for name, _ in besides.working}
    places = {name: [columns[n] for n in own] for name, own in numbers.items() if columns.keys() >= set(own)}
    if not places:
        return besides, draws
    try:
        found = working_of(problem.evaluator.scenes_at(draws.mean(axis=0)), tuple(places))
    except PftwinError:  # a mean beyond the scene's limits
        return besides, draws
    known, told = dict(besides.working), draws.copy()
    for name, own in places.items():
        there = np.stack(known[name].told_at(found[name], *draws[:, own].T), axis=1)
        if np.isfinite(there).all() and (there[:, :2] > 0).all() and found[name].taut(there[:, 1].max()):
            told[:, own], known[name] = there, found[name]
    return replace(besides, working=tuple(known.items())), told
