"""Posterior of nuisance parameters, given the requested ones, from knees simulated where the posterior lies.

There summaries x of a recording are nearly linear in all parameters. Given the requested parameters u, nuisance
parameters z with a normal prior are then normal too:

    x = a + A u + B z + e,    cov(e) = C,    z ~ N(m, V)
    precision of z:  B' C^-1 B + V^-1,    mean:  its inverse times  B' C^-1 (x - a - A u) + V^-1 m

C covers the effect of noise and sensor errors on summaries, and the residual of the linear model.
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

_ITERATIONS = 3  # iterations, from the prior on; each simulates knees from the posterior of the one before
_KNEES, _PER_PARAMETER = 192, 6  # knees per iteration, at least, and per parameter
_TRIES = 100  # most attempts to draw within the bounds
_SPRING_FIELDS = ("stiffness", "slack_length", "stiffening")  # parameters of a tendon that stiffens
_CONSTANT = 1e-9  # spread of a parameter over the knees, as a share of its mean, that is rounding


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
    """Draws (N, p) of all parameters of a problem, from draws (N, d) of the requested ones.

    `recording` (n, m) is relative to the motion in `held`; `learned` provides summaries and noise. If too few knees run
    to fit the linear model, nuisance parameters stay as in the iteration before, at first as drawn from their prior.
    """
    parameters, d = problem.parameters, asked.shape[1]
    if len(parameters) == d:
        return asked
    draws = np.concatenate([asked, parameters.scattered(len(asked), random)[:, d:]], axis=1)
    for _ in range(_ITERATIONS):
        some = draws[: max(_KNEES, _PER_PARAMETER * len(parameters))]
        predictions = problem.evaluator.values(some, substeps)
        freedom = int(predictions.usable.sum()) - len(parameters) - 1
        if freedom < 1.2 * learned.middle.size:  # too few to estimate a covariance
            break
        values = predictions.values[predictions.usable]
        x = learned.scaled_summaries(held.residuals(values).astype(np.float32))
        misread = (
            learned.scaled_summaries(held.residuals(sensed(values, nuisance, problem, random)).astype(np.float32)) - x
        )
        fitted = _LinearModel.of(some[predictions.usable], x, misread, learned.added.root)
        mean, root = fitted.given(learned.scaled_summaries(recording[None])[0], asked, parameters)
        draws = np.concatenate([asked, _within(mean, root, parameters, random)], axis=1)
    return draws


class _LinearModel(NamedTuple):
    """Whitened summaries as a linear function of all parameters."""

    center: Floats  # (p,)
    at: Floats  # (k,) summaries there
    slopes: Floats  # (k, p)
    whitening: Floats  # (k, k)

    @staticmethod
    def of(theta: Floats, x: Floats, misread: Floats, noise_root: Floats) -> _LinearModel:
        """Fits summaries (N, k) of simulated knees (N, p); `misread` (N, k) are the changes due to sensor errors."""
        center, at, deviations = theta.mean(axis=0), x.mean(axis=0), theta.std(axis=0)
        scale = np.where(
            deviations > _CONSTANT * np.abs(center), deviations, np.inf
        )  # a constant parameter has no slope
        t = (theta - center) / scale
        slopes = np.linalg.lstsq(t, x - at, rcond=None)[0]
        left = x - at - t @ slopes
        # The inverse of a covariance from few knees is too large by freedom / (freedom - k - 1) on average.
        covariance = noise_root @ noise_root.T + left.T @ left / (len(x) - t.shape[1] - 2 - x.shape[1])
        covariance += misread.T @ misread / len(x)
        values, vectors = np.linalg.eigh(covariance)
        whitening = (vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
        return _LinearModel(center, whitening @ at, whitening @ slopes.T / scale, whitening)

    def given(self, x: Floats, asked: Floats, parameters: Parameters) -> tuple[Floats, Floats]:
        """Means (N, q) of nuisance parameters given a recording's summaries (k,) and the requested ones (N, d), and the
        root (q, q) of their covariance."""
        d = asked.shape[1]
        priors = [p.prior or (0.5 * (p.lower + p.upper), p.upper - p.lower) for p in parameters.items[d:]]
        prior, sd = np.array(priors).T
        b = self.slopes[:, d:] * sd  # in units of the priors' standard deviations
        left = self.whitening @ x - self.at - (asked - self.center[:d]) @ self.slopes[:, :d].T
        middle = (self.center[d:] - prior) / sd
        precision = b.T @ b + np.eye(len(sd))
        mean = np.linalg.solve(precision, b.T @ (left + b @ middle).T).T
        root = np.linalg.inv(np.linalg.cholesky(precision)).T
        return prior + sd * mean, sd[:, None] * root


def _within(mean: Floats, root: Floats, parameters: Parameters, random: np.random.Generator) -> Floats:
    """Normal draws (N, q) about means; rows beyond the bounds are drawn again, and finally clipped."""
    d = len(parameters) - mean.shape[1]
    lower, upper = parameters.lower[d:], parameters.upper[d:]
    drawn = mean + random.standard_normal(mean.shape) @ root.T
    for _ in range(_TRIES):
        beyond = np.flatnonzero(((drawn < lower) | (drawn > upper)).any(axis=1))
        if not beyond.size:
            break
        drawn[beyond] = mean[beyond] + random.standard_normal((beyond.size, mean.shape[1])) @ root.T
    return np.clip(drawn, lower, upper)


def at_own_lengths(problem: Problem, nuisance: Nuisance, draws: Floats) -> tuple[Nuisance, Floats]:
    """Draws (N, p) and nuisance, re-expressed for the lengths at which tendons work in the motions of the draws' mean.

    Stiffening springs are learned as lines over the nominal knee's working lengths, which are the same for all
    simulations. A laboratory with a load cell would measure the line over the lengths that occurred. Draws are given
    by that line; their springs are unchanged. A tendon is left as it is if its stiffness, slack length and stiffening
    are not all free, one of them differs between trials, or it would be slack in some draw. All are left if that motion
    cannot be simulated, which is reported when the fit is judged.
    """
    parameters = problem.parameters
    vary = {parameters.items[at].place for at, _ in parameters.differences}
    columns = {p.place.name: i for i, p in enumerate(parameters.items) if p.place not in vary}
    numbers = {name: [f"{name}.{number}" for number in _SPRING_FIELDS] for name, _ in nuisance.working}
    places = {name: [columns[n] for n in own] for name, own in numbers.items() if columns.keys() >= set(own)}
    if not places:
        return nuisance, draws
    try:
        found = working_of(problem.evaluator.scenes_at(draws.mean(axis=0)), tuple(places))
    except PftwinError:  # a mean beyond the scene's limits
        return nuisance, draws
    known, converted = dict(nuisance.working), draws.copy()
    for name, own in places.items():
        there = np.stack(known[name].converted_to(found[name], *draws[:, own].T), axis=1)
        if np.isfinite(there).all() and (there[:, :2] > 0).all() and found[name].taut(there[:, 1].max()):
            converted[:, own], known[name] = there, found[name]
    return replace(nuisance, working=tuple(known.items())), converted
