"""What simulated recordings tell about a measured one."""

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


_SUMMARIES = 80
_SOME = 2000  # recordings that tell directions of the summaries, and the noise
_NETWORKS = 3  # trained from different starts
_WORSE = 0.3  # networks that tell less than the best by more than this [nats] are left out
_NOISE_ROUNDS, _NOISE_DRAWS = 3, 100  # of a search for noise that leaves what measurements leave
_TRIES = 100  # of drawing


class Answer(NamedTuple):
    """The posterior of one recording."""

    draws: Floats  # (N, p); of what is asked for alone before nuisance is added
    distance: float  # of its farthest summary from the simulations' mean, in their standard deviations
    level: float  # of its noise, by that which was learned from

    def doubts(self, source: str, limits: Limits) -> list[str]:
        """What is said of a recording from this source that lies far from those that were simulated. Raises InputError:
        it lies farther from them than the limits allow."""
        far = f"a summary of them is {self.distance:.0f} standard deviations from its mean"
        said = f"the measurements lie outside of what was simulated: {far}"
        return bounded("simulated", self.distance, said, source, limits)


class Learned(NamedTuple):
    """The posterior of what is asked for, of any recording like the simulated ones."""

    region: Region
    networks: tuple[PosteriorNetwork, ...]
    table: Table
    summaries: Summaries
    middle: Floats  # (k,) and
    size: Floats  # (k,) of summaries, which networks have scaled
    center: Floats  # (d,) and
    scale: Floats  # (d,) of the region's coordinates
    noise: Noise  # that recordings were given
    added: SummaryNoise  # what it does to summaries
    usual: float  # root mean square of what is left of noise alone, in its units

    def seen(self, recordings: Rows) -> Floats:
        """Summaries (N, k), scaled, of recordings (N, n, m): how far they are from what simulated ones were held to."""
        return (self.summaries(self.table.rows(recordings)) - self.middle) / self.size

    def answer(self, recording: Rows, count: int, random: np.random.Generator, wider: Floats | float = 1.0) -> Answer:
        """The posterior of a recording (n, m), as `seen` has it, with so many draws of what is asked for; `wider` (d,):
        how many times it is to be as wide. Raises PftwinError: hardly any of what the networks say lies within the
        region."""
        at = self.seen(recording[None])[0]
        left = self.summaries.unexplained(self.table.rows(recording[None]))
        distance = float(np.abs(at).max())
        return Answer(self._draws(at, count, random, wider), distance, float(np.sqrt(np.mean(left**2))) / self.usual)

    def coordinates_drawn(self, at: Floats, count: int, random: np.random.Generator) -> Floats:
        """Scaled coordinates (N, M, d) of recordings with summaries (N, k), bounds aside; M is at least `count`."""
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
    """From recordings simulated without noise, but with what sensors may be off by, of parameters `theta` (N, p) from
    the region.

    `simulated` (N, n, m) tells how far each is from some other recording, as `Objective.residuals` has it, `measured`
    (n, m) the same of the measurements, which tell what noise is like; `noise` is that of the round before.
    """
    from fitting.inference.network import trained  # with optax, which no other fit needs

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
    """Noise like what no simulation explains of the measurements, found from a first guess."""
    shape = objective.present.shape
    for _ in range(_NOISE_ROUNDS):
        table = Table(1, noise.deviations)
        summaries = Summaries.of(table.rows(simulated), _SUMMARIES)
        left = summaries.unexplained(table.rows(measured[None]))
        drawn = summaries.unexplained(summaries.mean + table.rows(noise.drawn(_NOISE_DRAWS, objective, random)))
        noise = noise.like(objective, *(a.reshape(-1, *shape) * noise.deviations for a in (left, drawn)))
    return noise
