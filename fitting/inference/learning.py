"""Learns the posterior of the requested parameters from simulated recordings, and answers a measured one."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fitting.channel_checks import Limits, bounded
from fitting.inference.recordings import Noise, Summaries, SummaryNoise, Table
from fitting.inference.region import Region
from fitting.objective import Objective
from pftwin.base.arrays import Floats, Rows
from pftwin.base.errors import PftwinError

if TYPE_CHECKING:
    from fitting.inference.network import PosteriorNetwork


_SUMMARIES = 80  # principal components
_SOME = 2000  # recordings used to compute the principal components and the noise
_NETWORKS = 3  # trained from different initial weights
_WORSE = 0.3  # networks whose loss exceeds the best by more than this [nats] are discarded
_NOISE_ROUNDS, _NOISE_DRAWS = 3, 100  # iterations and draws in the estimation of the noise
_TRIES = 100  # most attempts to draw within the region


class Answer(NamedTuple):
    """The posterior of one recording."""

    draws: Floats  # (N, p); the requested parameters alone before nuisance is added
    distance: float  # largest distance of a summary from the simulations' mean, in their standard deviations
    level: float  # its unexplained part, in units of the training noise

    def doubts(self, source: str, limits: Limits) -> list[str]:
        """Doubts if the recording lies far from the simulated ones. Raises InputError if it lies farther than the
        limits allow."""
        far = f"a summary of them is {self.distance:.0f} standard deviations from its mean"
        said = f"the measurements lie outside of what was simulated: {far}"
        return bounded("simulated", self.distance, said, source, limits)


class Learned(NamedTuple):
    """The learned posterior of the requested parameters, for any recording like the simulated ones."""

    region: Region
    networks: tuple[PosteriorNetwork, ...]
    table: Table
    summaries: Summaries
    middle: Floats  # (k,) mean and
    size: Floats  # (k,) standard deviation of summaries, by which networks' inputs are scaled
    center: Floats  # (d,) mean and
    scale: Floats  # (d,) standard deviation of the region's coordinates
    noise: Noise  # noise of the training recordings
    added: SummaryNoise  # the same in summaries
    usual: float  # root mean square of the unexplained part of noise alone, in its units

    def scaled_summaries(self, recordings: Rows) -> Floats:
        """Scaled summaries (N, k) of recordings (N, n, m), which are relative to the same motion as in training."""
        return (self.summaries(self.table.rows(recordings)) - self.middle) / self.size

    def answer(self, recording: Rows, count: int, random: np.random.Generator, wider: Floats | float = 1.0) -> Answer:
        """The posterior of a recording (n, m), as in `scaled_summaries`, with `count` draws of requested parameters;
        `wider` (d,): factors by which it is widened. Raises PftwinError if hardly any of the networks' posterior lies
        within the region."""
        at = self.scaled_summaries(recording[None])[0]
        left = self.summaries.unexplained(self.table.rows(recording[None]))
        distance = float(np.abs(at).max())
        return Answer(self._draws(at, count, random, wider), distance, float(np.sqrt(np.mean(left**2))) / self.usual)

    def coordinates_drawn(self, at: Floats, count: int, random: np.random.Generator) -> Floats:
        """Scaled coordinates (N, M, d) for recordings with summaries (N, k), ignoring bounds; M is at least `count`."""
        each = -(-count // len(self.networks))
        return np.concatenate([net.draws(at, each, random) for net in self.networks], axis=1)

    def _draws(self, at: Floats, count: int, random: np.random.Generator, wider: Floats | float) -> Floats:
        region, found = self.region, np.zeros((0, self.region.asked))
        for _ in range(_TRIES):
            u = self.coordinates_drawn(at[None], count, random)[0]
            theta = region.from_coordinates(u * self.scale + self.center)
            theta = theta.mean(axis=0) + wider * (theta - theta.mean(axis=0))
            found = np.concatenate([found, theta[region.contains(theta)]])
            if len(found) >= count:
                return random.permutation(found)[:count]
        raise PftwinError(
            "the posterior that was learned lies beyond the bounds: a summary of the measurements is "
            f"{np.abs(at).max():.0f} standard deviations from the simulations' mean; try: wider bounds"
        )


def learn(
    region: Region,
    theta: Floats,
    simulated: Rows,
    measured: Rows,
    objective: Objective,
    noise: Noise,
    random: np.random.Generator,
) -> Learned:
    """Learns from recordings simulated without noise, but with sensor errors, of parameters `theta` (N, p) from the
    region.

    `simulated` (N, n, m) and `measured` (n, m) are relative to the same motion, as in `Objective.residuals`; the noise
    is estimated from the measurements, starting from `noise`, that of the previous round.
    """
    from fitting.inference.network import trained  # imports optax, which other fits do not need

    some = random.permutation(len(simulated))[:_SOME]
    noise = _noise_like(objective, simulated[some], measured, noise, random)
    table = Table.of(objective, noise)
    clean = table.rows(simulated)
    summaries = Summaries.of(clean[some], _SUMMARIES)
    added = SummaryNoise.of(noise, objective, table, summaries)
    x = summaries(clean)
    middle, size = x.mean(axis=0), (x + added.drawn(len(x), random)).std(axis=0)
    x, added = (x - middle) / size, added.scaled(size)
    u = region.coordinates(theta[:, : region.asked])
    center, scale = u.mean(axis=0), u.std(axis=0)
    u = (u - center) / scale
    tried = [trained(x, u, added, int(seed)) for seed in random.integers(2**31, size=_NETWORKS)]
    least = min(loss for _, loss in tried)
    alone = table.rows(noise._replace(span=1.0).drawn(_NOISE_DRAWS, objective, random))
    return Learned(
        region,
        tuple(net for net, loss in tried if loss <= least + _WORSE),
        table,
        summaries,
        middle,
        size,
        center,
        scale,
        noise,
        added,
        float(np.sqrt(np.mean(summaries.unexplained(summaries.mean + alone) ** 2))),
    )


def _noise_like(
    objective: Objective, simulated: Rows, measured: Rows, noise: Noise, random: np.random.Generator
) -> Noise:
    """Noise like the part of the measurements that simulations do not explain, by iteration from a first guess."""
    shape = objective.present.shape
    for _ in range(_NOISE_ROUNDS):
        table = Table(1, noise.deviations)
        summaries = Summaries.of(table.rows(simulated), _SUMMARIES)
        left = summaries.unexplained(table.rows(measured[None]))
        drawn = summaries.unexplained(summaries.mean + table.rows(noise.drawn(_NOISE_DRAWS, objective, random)))
        noise = noise.like(objective, *(a.reshape(-1, *shape) * noise.deviations for a in (left, drawn)))
    return noise
