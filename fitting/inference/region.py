"""Where parameters are drawn: from their priors, within bounds, and within an ellipsoid once a posterior is known.

Cutting a prior off where the posterior is as good as nothing leaves the posterior as it was, so recordings that are
simulated within the cut need no weights: truncated proposals (Deistler, Goncalves & Macke 2022, NeurIPS 35).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from scipy.stats import chi2, norm

from fitting.parameters import Parameters
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError

_NARROWEST = 0.01  # least half width of what nuisance is drawn from, as a share of its bounds
_INSIDE, _MARGIN = 0.999, 1.6  # share of a normal posterior within the ellipsoid, and by how much it is larger still
_TRIES = 200  # of drawing; each should give a good part of what is wanted


class Ellipsoid(NamedTuple):
    """All theta with |root^-1 (theta - mean)| < radius."""

    mean: Floats  # (d,)
    root: Floats  # (d, d) lower triangular
    radius: float

    @staticmethod
    def around(draws: Floats) -> Ellipsoid:
        """One that holds nearly all of a posterior with these draws (N, d)."""
        d = draws.shape[1]
        root = np.asarray(np.linalg.cholesky(np.cov(draws.T).reshape(d, d)), dtype=np.float64)
        return Ellipsoid(draws.mean(axis=0), root, _MARGIN * float(np.sqrt(chi2.ppf(_INSIDE, d))))

    def coordinates(self, theta: Floats) -> Floats:
        """Of points (N, d): those within have norms below the radius."""
        return np.asarray(np.linalg.solve(self.root, (theta - self.mean).T).T, dtype=np.float64)

    def drawn(self, count: int, random: np.random.Generator) -> Floats:
        """Points (count, d), uniform within."""
        d = len(self.mean)
        directions = random.standard_normal((count, d))
        lengths = self.radius * random.uniform(size=(count, 1)) ** (1 / d)
        return self.mean + (lengths * directions / np.linalg.norm(directions, axis=1)[:, None]) @ self.root.T

    @property
    def size(self) -> float:
        """The logarithm of its mean half width, up to a constant."""
        return float(np.log(np.diagonal(self.root)).mean())


class Region(NamedTuple):
    """Where all p parameters lie: within their bounds, and the first d, which are asked for, within an ellipsoid."""

    parameters: Parameters
    ellipsoid: Ellipsoid | None = None

    def around(self, draws: Floats) -> Region:
        """The part of it that holds nearly all of a posterior with these draws (N, p)."""
        d, items = self.asked, list(self.parameters.items)
        reach = _MARGIN * float(norm.ppf(0.5 + 0.5 * _INSIDE)) * draws.std(axis=0)
        for i in range(d, len(items)):
            width = max(reach[i], _NARROWEST * (items[i].upper - items[i].lower))
            middle = float(np.clip(draws[:, i].mean(), items[i].lower + width, items[i].upper - width))
            low, high = min(draws[:, i].mean(), middle) - width, max(draws[:, i].mean(), middle) + width
            items[i] = replace(items[i], lower=max(items[i].lower, low), upper=min(items[i].upper, high))
        return Region(Parameters(tuple(items)), Ellipsoid.around(draws[:, :d]))

    @property
    def asked(self) -> int:
        """How many parameters are asked for, d."""
        return self.parameters.asked

    @property
    def size(self) -> float:
        """The ellipsoid's; infinite without one."""
        return np.inf if self.ellipsoid is None else self.ellipsoid.size

    def like(self, before: Region, tolerance: float) -> bool:
        """Whether size (in logarithms) and middle (in deviations) are those of the region before, to a tolerance."""
        if self.ellipsoid is None or before.ellipsoid is None:
            return False
        moved = (self.ellipsoid.mean - before.ellipsoid.mean) / np.linalg.norm(self.ellipsoid.root, axis=1)
        return abs(self.size - before.size) < tolerance and bool(np.abs(moved).max() < tolerance)

    @property
    def widest(self) -> float:
        """As `size`, of the bounds."""
        lower, upper = self._bounds
        return float(np.log(0.5 * (upper - lower)).mean())

    @property
    def _bounds(self) -> tuple[Floats, Floats]:
        return self.parameters.lower[: self.asked], self.parameters.upper[: self.asked]

    def contains(self, theta: Floats) -> NDArray[np.bool_]:
        """Which of (N, d) lie within bounds and ellipsoid."""
        lower, upper = self._bounds
        inside = np.asarray(((theta > lower) & (theta < upper)).all(axis=1))
        if self.ellipsoid is None:
            return inside
        return inside & (np.linalg.norm(self.ellipsoid.coordinates(theta), axis=1) < self.ellipsoid.radius)

    def drawn(self, count: int, random: np.random.Generator) -> Floats:
        """Parameters (count, p) from the priors, those asked for within the region. Raises InputError: next to nothing
        of the priors lies in it."""
        theta = self.parameters.scattered(count, random)
        if self.ellipsoid is None:
            return theta
        found, priors = np.zeros((0, self.asked)), Parameters(self.parameters.items[: self.asked])
        for _ in range(_TRIES):
            trial = self.ellipsoid.drawn(count, random)
            trial = trial[self.contains(trial)]
            cost = priors.prior_terms(trial)[0]
            kept = random.uniform(size=len(trial)) < np.exp(cost.min(initial=np.inf) - cost)
            found = np.concatenate([found, trial[kept]])
            if len(found) >= count:
                theta[:, : self.asked] = found[:count]
                return theta
        found = "next to nothing of the bounds and priors lies where the measurements put the parameters"
        raise InputError(found, where="bounds and priors", expected="wider ones")

    def coordinates(self, theta: Floats) -> Floats:
        """(N, d) as numbers that a normal distribution describes well: the ellipsoid's, or free of bounds."""
        if self.ellipsoid is not None:
            return self.ellipsoid.coordinates(theta)
        lower, upper = self._bounds
        share = np.clip((theta - lower) / (upper - lower), 1e-9, 1 - 1e-9)
        return np.log(share) - np.log1p(-share)

    def from_coordinates(self, u: Floats) -> Floats:
        """The inverse of `coordinates`."""
        if self.ellipsoid is not None:
            return self.ellipsoid.mean + u @ self.ellipsoid.root.T
        lower, upper = self._bounds
        return lower + (upper - lower) * expit(u)
