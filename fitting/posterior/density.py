"""Posterior density of an estimate's parameters, from the estimate's noise, priors and bounds.

The density is exp(-|f|^2 / 2) within the bounds, with f the residuals in units of their noise, priors included. If
neighbouring residuals are correlated, treating the noise as independent makes it too narrow. It is then tempered to the
estimate's covariance C (Newey and West): f(m + A (theta - m)) replaces f(theta), with m the estimate and A such that
the curvature at m becomes that of C. This is the curvature adjustment of Ribatet, Cooley and Davison
(arXiv:0911.5357); a profile of it is scaled as `fitting.profile_likelihood` scales its own.
Priors are tempered along with the likelihood, as in that profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.estimate import Estimate
from fitting.fit import likelihood_of
from fitting.methods.problem import Problem
from fitting.uncertainty import SERIAL
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

BLOCK = 128  # points whose residuals are in memory at once
_SMALLEST = 1e-12  # eigenvalues of the scaled information below this share of the largest are rounding


class EvaluatedPoints(NamedTuple):
    """The density at N points, and its residuals projected onto p directions."""

    theta: Floats  # (N, p)
    log_density: Floats  # (N,) up to a constant: -|f|^2 / 2
    along: Floats  # (N, p): Q'f
    slope: Floats  # (N, p, p): derivatives of `along`, Q' df/dtheta
    usable: NDArray[np.bool_]  # (N,) whether the motion could be simulated


@dataclass(frozen=True, eq=False)
class Density:
    """A posterior density as a sum of squared residuals; made by `Density.of`."""

    problem: Problem
    centre: Floats  # m (p,)
    squeeze: Floats  # A (p, p)
    frame: Floats  # Q (k, p): orthonormal basis of the residuals' derivatives at the centre

    @staticmethod
    def of(estimate: Estimate, measured: Measured | Sequence[Measured] | None) -> Density:
        """The density of an estimate by likelihood. Raises InputError as `likelihood_of` does, or if the measurements
        do not determine the parameters."""
        problem = likelihood_of(estimate, measured)
        centre = np.asarray(estimate.values, dtype=np.float64)
        covariance = estimate.covariance if estimate.serial_correlation > SERIAL else None
        return Density.about(problem, centre, covariance)

    @staticmethod
    def about(problem: Problem, centre: Floats, covariance: Floats | None = None) -> Density:
        """The density of a problem, tempered to a covariance (p, p) if given. Raises InputError if the motion at the
        centre cannot be simulated or does not determine the parameters."""
        p = len(centre)
        _, slopes, usable = _residuals(problem, centre[None])
        if not usable[0]:
            raise InputError("the motion at the estimate cannot be simulated", where="estimate")
        information = slopes[0].T @ slopes[0]
        scale = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
        values = np.linalg.eigvalsh(information / np.outer(scale, scale))
        if not values[0] > _SMALLEST * values[-1]:
            raise _open()
        squeeze = np.eye(p) if covariance is None else tempering(information, covariance)
        return Density(problem, centre, squeeze, np.linalg.qr(slopes[0] @ squeeze)[0])

    def __call__(self, theta: Floats) -> EvaluatedPoints:
        """Evaluates the density at points (N, p), which may lie outside the bounds."""
        residuals, slopes, usable = _residuals(self.problem, self.centre + (theta - self.centre) @ self.squeeze.T)
        log_density = np.where(usable, -0.5 * np.sum(residuals**2, axis=1), -np.inf)
        slope = np.einsum("kq,nkp->nqp", self.frame, slopes) @ self.squeeze
        return EvaluatedPoints(theta, log_density, residuals @ self.frame, slope, usable)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the parameters (p,)."""
        return self.problem.parameters.lower, self.problem.parameters.upper


def _residuals(problem: Problem, theta: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Residuals in units of their noise, priors last (N, k), derivatives (N, k, p), and which are usable (N,)."""
    target, parameters = problem.objective, problem.parameters
    predictions = problem.evaluator.with_slopes(theta, problem.evaluator.fine)
    sigma, (n, p), (r, j) = target.noise_columns / np.sqrt(target.share), theta.shape, target.linear(predictions)
    r, j = (r / sigma).reshape(n, -1), (j / sigma[:, None]).reshape(n, -1, p)
    known = [i for i, item in enumerate(parameters.items) if item.prior is not None]
    if known:
        mean, sd = np.array([parameters.items[i].prior for i in known], dtype=np.float64).T
        r = np.concatenate([r, (theta[:, known] - mean) / sd], axis=1)
        j = np.concatenate([j, np.broadcast_to(np.eye(p)[known] / sd[:, None], (n, len(known), p))], axis=1)
    return r, j, predictions.usable


def tempering(information: Floats, covariance: Floats) -> Floats:
    """Matrix A (p, p) with A' H A = C^-1, independent of the parameters' units; H information, C covariance. Raises
    InputError if the covariance is singular: a combination of parameters is not determined."""
    scale = np.sqrt(np.diagonal(information))
    eigenvalues = np.linalg.eigvalsh(covariance * np.outer(scale, scale))
    if not (np.isfinite(eigenvalues).all() and eigenvalues[0] > _SMALLEST * eigenvalues[-1]):
        raise _open()
    root = np.linalg.cholesky(information / np.outer(scale, scale)) * scale[:, None]  # H = root root'
    widths, vectors = np.linalg.eigh(root.T @ covariance @ root)
    shrunk = (vectors / np.sqrt(widths)) @ vectors.T
    return np.asarray(np.linalg.solve(root.T, shrunk @ root.T), dtype=np.float64)


def _open() -> InputError:
    return InputError(
        "the measurements leave a combination of the parameters open",
        where="estimate",
        expected="parameters that they fix",
        remedy="fewer parameters, or priors",
    )
