"""Region in which parameters are drawn: their priors, within bounds, and within an ellipsoid once a posterior is known.

Truncating a prior where the posterior is negligible does not change the posterior, so recordings simulated within the
region need no importance weights: truncated proposals (Deistler, Goncalves & Macke 2022, NeurIPS 35).
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

_NARROWEST = 0.01  # least half width of the range of a nuisance parameter, as a share of its bounds
_INSIDE, _MARGIN = 0.999, 1.6  # share of a normal posterior within the ellipsoid, and a factor by which it is enlarged
_TRIES = 200  # most attempts to draw; each should give a good part of what is wanted


class Ellipsoid(NamedTuple):
    """All theta with |root^-1 (theta - mean)| < radius."""

    mean: Floats  # (d,)
    root: Floats  # (d, d) lower triangular
    radius: float

    @staticmethod
    def around(draws: Floats) -> Ellipsoid:
        """An ellipsoid that contains nearly all of a posterior with these draws (N, d)."""
        d = draws.shape[1]
        root = np.asarray(np.linalg.cholesky(np.cov(draws.T).reshape(d, d)), dtype=np.float64)
        return Ellipsoid(draws.mean(axis=0), root, _MARGIN * float(np.sqrt(chi2.ppf(_INSIDE, d))))

    def coordinates(self, theta: Floats) -> Floats:
        """Coordinates of points (N, d): those inside have norms below the radius."""
        return np.asarray(np.linalg.solve(self.root, (theta - self.mean).T).T, dtype=np.float64)

    def drawn(self, count: int, random: np.random.Generator) -> Floats:
        """Points (count, d), uniform within the ellipsoid."""
        d = len(self.mean)
        directions = random.standard_normal((count, d))
        lengths = self.radius * random.uniform(size=(count, 1)) ** (1 / d)
        return self.mean + (lengths * directions / np.linalg.norm(directions, axis=1)[:, None]) @ self.root.T

    @property
    def size(self) -> float:
        """The logarithm of its mean half width, up to a constant."""
        return float(np.log(np.diagonal(self.root)).mean())


class Region(NamedTuple):
    """Where all p parameters are drawn: within their bounds, the first d, the requested ones, within an ellipsoid."""

    parameters: Parameters
    ellipsoid: Ellipsoid | None = None

    def around(self, draws: Floats) -> Region:
        """The part of the region that contains nearly all of a posterior with these draws (N, p)."""
        d, items = self.asked, list(self.parameters.items)
        half_widths = _MARGIN * float(norm.ppf(0.5 + 0.5 * _INSIDE)) * draws.std(axis=0)
        for i in range(d, len(items)):
            width = max(half_widths[i], _NARROWEST * (items[i].upper - items[i].lower))
            middle = float(np.clip(draws[:, i].mean(), items[i].lower + width, items[i].upper - width))
            low, high = min(draws[:, i].mean(), middle) - width, max(draws[:, i].mean(), middle) + width
            items[i] = replace(items[i], lower=max(items[i].lower, low), upper=min(items[i].upper, high))
        return Region(Parameters(tuple(items)), Ellipsoid.around(draws[:, :d]))

    @property
    def asked(self) -> int:
        """Number of requested parameters, d."""
        return self.parameters.asked

    @property
    def size(self) -> float:
        """Size of the ellipsoid (log of the mean half width); infinite without one."""
        return np.inf if self.ellipsoid is None else self.ellipsoid.size

    def like(self, before: Region, tolerance: float) -> bool:
        """Whether size (log) and centre (in standard deviations) agree with the previous region's, to a tolerance."""
        if self.ellipsoid is None or before.ellipsoid is None:
            return False
        moved = (self.ellipsoid.mean - before.ellipsoid.mean) / np.linalg.norm(self.ellipsoid.root, axis=1)
        return abs(self.size - before.size) < tolerance and bool(np.abs(moved).max() < tolerance)

    @property
    def widest(self) -> float:
        """As `size`, for the bounds."""
        lower, upper = self._bounds
        return float(np.log(0.5 * (upper - lower)).mean())

    @property
    def _bounds(self) -> tuple[Floats, Floats]:
        return self.parameters.lower[: self.asked], self.parameters.upper[: self.asked]

    def contains(self, theta: Floats) -> NDArray[np.bool_]:
        """Which points (N, d) lie within bounds and ellipsoid."""
        lower, upper = self._bounds
        inside = np.asarray(((theta > lower) & (theta < upper)).all(axis=1))
        if self.ellipsoid is None:
            return inside
        return inside & (np.linalg.norm(self.ellipsoid.coordinates(theta), axis=1) < self.ellipsoid.radius)

    def drawn(self, count: int, random: np.random.Generator) -> Floats:
        """Parameters (count, p) from the priors, the requested ones within the region. Raises InputError if almost none
        of the prior lies in it."""
        theta = self.parameters.scattered(count, random)
        if self.ellipsoid is None:
            return theta
        found, priors = np.zeros((0, self.asked)), Parameters(self.parameters.items[: self.asked])
        for _ in range(_TRIES):
            trial = self.ellipsoid.drawn(count, random)
            trial = trial[self.contains(trial)]
            cost = priors.prior_terms(trial)[0]
            accepted = random.uniform(size=len(trial)) < np.exp(cost.min(initial=np.inf) - cost)
            found = np.concatenate([found, trial[accepted]])
            if len(found) >= count:
                theta[:, : self.asked] = found[:count]
                return theta
        found = "next to nothing of the bounds and priors lies where the measurements put the parameters"
        raise InputError(found, where="bounds and priors", expected="wider ones")

    def coordinates(self, theta: Floats) -> Floats:
        """Points (N, d) in coordinates in which they are nearly normal: the ellipsoid's, or the logit of the bounds."""
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
