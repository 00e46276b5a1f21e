"""What one round of simulated recordings tells about a measured one."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.inference.recordings import Noise, Summaries, SummaryNoise, Table
from fitting.inference.region import Region
from fitting.objective import Objective
from pftwin.base.errors import PftwinError

if TYPE_CHECKING:
    from fitting.inference.network import PosteriorNetwork

Floats = NDArray[np.float64]
Rows = NDArray[np.float32]

_SUMMARIES = 80
_SOME = 2000  # recordings that tell directions of the summaries, and the noise
_NETWORKS = 3  # trained from different starts
_WORSE = 0.3  # networks that tell less than the best by more than this [nats] are left out
_NOISE_ROUNDS, _NOISE_DRAWS = 3, 100  # of a search for noise that leaves what measurements leave
_TRIES = 100  # of drawing
_FAR = 5.0  # least distance of a summary of the measurements from the simulated ones' mean, in their deviations


class Learned(NamedTuple):
    """The posterior of one measured recording, by networks and, for nuisance, by linear regression."""

    region: Region
    networks: tuple[PosteriorNetwork, ...]
    measured: Floats  # summaries of the measurements (k,), scaled as the network has them
    center: Floats  # (d,) and
    scale: Floats  # (d,) of the region's coordinates
    nuisance: tuple[Floats, Floats]  # coefficients (k + d + 1, p - d), and the root of what they leave (p - d, p - d)
    distance: float  # of the farthest summary of the measurements, in standard deviations
    noise: Noise  # that recordings were given

    @property
    def strange(self) -> bool:
        """Whether the measurements lie outside of what was simulated."""
        return self.distance > _FAR

    def draws(self, count: int, random: np.random.Generator) -> Floats:
        """Parameters (count, p) from the posterior, within the bounds.

        Raises:
            PftwinError: hardly any of what the networks say lies within the region.
        """
        region, found = self.region, np.zeros((0, self.region.asked))
        for _ in range(_TRIES):
            each = -(-count // len(self.networks))
            u = np.concatenate([net.draws(self.measured, each, random) for net in self.networks])
            theta = region.from_coordinates(u * self.scale + self.center)
            found = np.concatenate([found, theta[region.contains(theta)]])
            if len(found) >= count:
                found = random.permutation(found)[:count]
                return np.concatenate([found, self._nuisance_draws(found, random)], axis=1)
        raise PftwinError(
            "the posterior that was learned lies beyond the bounds: a summary of the measurements is "
            f"{self.distance:.0f} standard deviations from the simulations' mean; try: wider bounds"
        )

    def _nuisance_draws(self, theta: Floats, random: np.random.Generator) -> Floats:
        """(N, p - d) given what is asked for (N, d): rows beyond the bounds are drawn again."""
        weights, root = self.nuisance
        p, d = self.region.parameters, self.region.asked
        u = (self.region.coordinates(theta) - self.center) / self.scale
        mean = _with_one(np.tile(self.measured, (len(u), 1)), u) @ weights
        lower, upper = p.lower[d:], p.upper[d:]
        drawn = mean + random.standard_normal(mean.shape) @ root.T
        for _ in range(_TRIES):
            beyond = np.flatnonzero(((drawn < lower) | (drawn > upper)).any(axis=1))
            if not beyond.size:
                break
            drawn[beyond] = mean[beyond] + random.standard_normal((beyond.size, mean.shape[1])) @ root.T
        return np.clip(drawn, lower, upper)


def learn(
    region: Region, theta: Floats, simulated: Rows, objective: Objective, noise: Noise, random: np.random.Generator
) -> Learned:
    """From recordings simulated without noise.

    Args:
        region: where parameters were drawn.
        theta: (N, p) the parameters.
        simulated: (N, n, m) how far each recording is from the measurements: `Objective.residuals`.
        objective: the measurements.
        noise: what the measurements' noise was like in the round before.
        random: of noise and training.
    """
    from fitting.inference.network import trained  # with optax, which no other fit needs

    some = random.permutation(len(simulated))[:_SOME]
    noise = _noise_like(objective, simulated[some], noise, random)
    table = Table.of(objective, noise)
    clean = table.rows(simulated)
    summaries = Summaries.of(clean[some], _SUMMARIES)
    added = SummaryNoise.of(noise, objective, table, summaries)
    x = summaries(clean)
    x_mean, x_sd = x.mean(axis=0), (x + added.drawn(len(x), random)).std(axis=0)
    x, added = (x - x_mean) / x_sd, added.scaled(x_sd)
    nothing = np.zeros((1, clean.shape[1]), np.float32)  # the measurements' distance from themselves
    measured = ((summaries(nothing) - x_mean) / x_sd)[0]
    u = region.coordinates(theta[:, : region.asked])
    center, scale = u.mean(axis=0), u.std(axis=0)
    u = (u - center) / scale
    tried = [trained(x, u, added, int(seed)) for seed in random.integers(2**31, size=_NETWORKS)]
    least = min(loss for _, loss in tried)
    known = _with_one(x + added.drawn(len(x), random), u)
    return Learned(
        region,
        tuple(net for net, loss in tried if loss <= least + _WORSE),
        measured,
        center,
        scale,
        _regression(known, theta[:, region.asked :], _with_one(measured[None], np.zeros_like(u[:1]))[0]),
        float(np.abs(measured).max()),
        noise,
    )


def _with_one(x: Floats, u: Floats) -> Floats:
    return np.concatenate([x, u, np.ones((len(x), 1))], axis=1)


def _regression(x: Floats, y: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Coefficients (k, q) of y (N, q) by x (N, k), and a root of the covariance of a prediction `at` some x (k,)."""
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    left = y - x @ weights
    leverage = float(at @ np.linalg.lstsq(x.T @ x, at, rcond=None)[0])
    values, vectors = np.linalg.eigh((1 + leverage) * left.T @ left / max(len(x) - x.shape[1], 1))
    return np.asarray(weights, dtype=np.float64), np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _noise_like(objective: Objective, simulated: Rows, noise: Noise, random: np.random.Generator) -> Noise:
    """Noise like what no simulation explains of the measurements, found from a first guess."""
    shape = objective.present.shape
    for _ in range(_NOISE_ROUNDS):
        table = Table(1, noise.deviations)
        summaries = Summaries.of(table.rows(simulated), _SUMMARIES)
        left = summaries.unexplained(np.zeros((1, summaries.mean.size), np.float32))
        drawn = summaries.unexplained(summaries.mean + table.rows(noise.drawn(_NOISE_DRAWS, objective, random)))
        noise = noise.like(objective, *(a.reshape(-1, *shape) * noise.deviations for a in (left, drawn)))
    return noise
