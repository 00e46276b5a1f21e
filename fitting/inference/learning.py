"""What one round of simulated recordings tells about a measured one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.inference.network import PosteriorNetwork, trained
from fitting.inference.recordings import Noise, Summaries, Table
from fitting.inference.region import Region
from fitting.objective import Objective
from pftwin.base.errors import PftwinError

Floats = NDArray[np.float64]
Rows = NDArray[np.float32]

_SUMMARIES = 80
_FOR_SUMMARIES, _FOR_NOISE = 1500, 750  # recordings that tell directions of the summaries, and what these leave
_NETWORKS = 3  # trained from different starts
_WORSE = 0.3  # networks that tell less than the best by more than this [nats] are left out
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
    left: Floats  # what no simulation explains of the measurements (n, m)
    freedom: float  # the share of noise that is left so

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
                break
        else:
            raise PftwinError(
                "the posterior that was learned lies outside of the bounds; try: wider bounds, another seed"
            )
        found = random.permutation(found)[:count]
        weights, root = self.nuisance
        u = (region.coordinates(found) - self.center) / self.scale
        besides = _with_one(np.tile(self.measured, (count, 1)), u) @ weights
        besides += random.standard_normal(besides.shape) @ root.T
        p, d = region.parameters, region.asked
        return np.concatenate([found, np.clip(besides, p.lower[d:], p.upper[d:])], axis=1)


def learn(
    region: Region, theta: Floats, simulated: Rows, objective: Objective, noise: Noise, random: np.random.Generator
) -> Learned:
    """From recordings simulated without noise.

    Args:
        region: where parameters were drawn.
        theta: (N, p) the parameters.
        simulated: (N, n, m) how far each recording is from the measurements: `Objective.residuals`.
        objective: the measurements.
        noise: what the measurements' noise is like.
        random: of noise and training.
    """
    table = Table.of(objective, noise)
    clean = table.rows(simulated)
    some = random.permutation(len(clean))[:_FOR_SUMMARIES]
    summaries = Summaries.of(clean[some], _SUMMARIES)
    x = summaries(clean + table.rows(noise.drawn(len(clean), objective, random)))
    nothing = np.zeros((1, clean.shape[1]), np.float32)  # the measurements' distance from themselves
    measured = summaries(nothing)
    x_mean, x_sd = x.mean(axis=0), x.std(axis=0)
    x, measured = (x - x_mean) / x_sd, ((measured - x_mean) / x_sd)[0]
    u = region.coordinates(theta[:, : region.asked])
    center, scale = u.mean(axis=0), u.std(axis=0)
    u = (u - center) / scale
    seeds = random.integers(2**31, size=_NETWORKS)
    tried = [trained(x, u, int(seed)) for seed in seeds]
    least = min(loss for _, loss in tried)
    return Learned(
        region,
        tuple(net for net, loss in tried if loss <= least + _WORSE),
        measured,
        center,
        scale,
        _regression(_with_one(x, u), theta[:, region.asked :]),
        float(np.abs(measured).max()),
        *_unexplained(objective, simulated[some[:_FOR_NOISE]], noise),
    )


def _with_one(x: Floats, u: Floats) -> Floats:
    return np.concatenate([x, u, np.ones((len(x), 1))], axis=1)


def _regression(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Coefficients (k, q) of y (N, q) by x (N, k), and a root of the covariance of what they leave."""
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    left = y - x @ weights
    values, vectors = np.linalg.eigh(left.T @ left / max(len(x) - x.shape[1], 1))
    return np.asarray(weights, dtype=np.float64), np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _unexplained(objective: Objective, simulated: Rows, noise: Noise) -> tuple[Floats, float]:
    """What the simulations' directions leave of the measurements (n, m), and the share of noise that they leave."""
    shape = objective.present.shape
    frames = Table(1, noise.deviations)
    summaries = Summaries.of(frames.rows(simulated), _SUMMARIES)
    nothing = np.zeros((1, summaries.mean.size), np.float32)
    left = nothing - summaries.mean - (summaries(nothing) @ summaries.directions.T)
    taken = summaries.directions.shape[1] / np.count_nonzero(objective.present)
    return left.reshape(shape) * noise.deviations, max(1 - taken, 0.1)
