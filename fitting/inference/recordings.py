"""Noise and summaries of simulated recordings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.signal import lfilter

from fitting.objective import Objective
from fitting.programs import ORIENTATION, POSITION
from pftwin.base.arrays import Floats, Rows

_NUMBERS = 1500  # most values per recording, roughly: neighbouring frames are averaged
_INITIAL = {POSITION: 2e-4, ORIENTATION: 2e-3}  # first guess of the noise [m], [rad]
_INITIAL_SHARE = 0.01  # the same for a force, as a share of its root mean square
_INITIAL_CORRELATION, _LARGEST_CORRELATION = 0.9, 0.999  # of the noise of neighbouring frames
_ROUNDING = 1e-10  # share of the largest variance below which variances are rounding
_SPAN = 2.0  # if the noise is not stated, a recording's level is drawn between 1 / span and span times the estimate


class Noise(NamedTuple):
    """Noise of each residual column (m,), first-order autoregressive from frame to frame."""

    deviations: Floats
    correlations: Floats
    span: float  # 1 if the level is known

    @staticmethod
    def initial(objective: Objective) -> Noise:
        """A first guess, or the stated noise."""
        levels = np.zeros(objective.present.shape[1])
        for channel, columns, rows in objective.columns():
            there = objective.present[:, rows.start]
            size = np.sqrt(np.mean(objective.measured[there, columns] ** 2))
            levels[rows] = _INITIAL.get(channel, _INITIAL_SHARE * size)
        return Noise(levels, np.full(len(levels), _INITIAL_CORRELATION), _SPAN)._within(objective)

    def like(self, objective: Objective, left: Floats, drawn: Floats) -> Noise:
        """Noise adjusted so that its unexplained part has the size and correlation of the measurements': simulations do
        not explain `left` (1, n, m) of the measurements, and `drawn` (N, n, m) of the present noise."""
        there, both = objective.present, objective.present[1:] & objective.present[:-1]
        ours, theirs = (np.maximum(np.sum(np.where(there, a**2, 0.0), axis=-2), 1e-300) for a in (left, drawn))
        ratio = np.sqrt(ours[0] / theirs.mean(axis=0))
        lagged, drawn_lagged = (
            np.sum(np.where(both, a[..., 1:, :] * a[..., :-1, :], 0.0), axis=-2) / size
            for a, size in ((left, ours), (drawn, theirs))
        )
        correlations = self.correlations + lagged[0] - drawn_lagged.mean(axis=0)
        bounded = np.clip(correlations, 0.0, _LARGEST_CORRELATION)
        return Noise(self.deviations * ratio, bounded, _SPAN)._within(objective)

    def _within(self, objective: Objective) -> Noise:
        """With the stated deviations, if any; otherwise at least those of rounding."""
        if objective.noise is not None:
            return self._replace(deviations=objective.noise_columns, span=1.0)
        return self._replace(deviations=np.maximum(self.deviations, np.sqrt(objective.floor)[objective.group_of]))

    def drawn(self, count: int, objective: Objective, random: np.random.Generator) -> Rows:
        """Draws of the noise (count, n, m), zero where nothing was measured."""
        n, m = objective.present.shape
        out = np.empty((count, n, m), np.float32)
        sizes = self.span ** random.uniform(-1.0, 1.0, count)
        for column, (sd, rho) in enumerate(zip(self.deviations, self.correlations, strict=True)):
            white = random.standard_normal((count, n), dtype=np.float32)
            for rows in objective.frames:  # trials are independent
                steps = white[:, rows]
                steps[:, 1:] *= np.float32(np.sqrt(1 - rho**2))
                white[:, rows] = lfilter([1.0], [1.0, -rho], steps, axis=1)
            out[..., column] = white * (sd * sizes[:, None])
        return np.where(objective.present, out, np.float32(0))


class Table(NamedTuple):
    """Converts recordings (N, n, m) to rows: means over blocks of frames, in units of the noise."""

    block: int
    scale: Floats  # (m,)

    @staticmethod
    def of(objective: Objective, noise: Noise) -> Table:
        """The table for an objective's measurements."""
        return Table(max(1, -(-objective.present.size // _NUMBERS)), noise.deviations)

    def rows(self, residuals: Rows) -> Rows:
        """Rows (N, d) of recordings (N, n, m)."""
        count, n, m = residuals.shape
        whole = n // self.block * self.block
        means = residuals[:, :whole].reshape(count, -1, self.block, m).mean(axis=2) / self.scale
        return means.reshape(count, -1).astype(np.float32)


class Summaries(NamedTuple):
    """The k principal components of recordings' rows (d,)."""

    mean: Rows  # (d,)
    directions: Rows  # (d, k) orthonormal
    variances: Floats  # (k,) of the recordings along them, ascending

    @staticmethod
    def of(rows: Rows, count: int) -> Summaries:
        """Principal components of rows without noise (N, d)."""
        mean = rows.mean(axis=0)
        centered = (rows - mean).astype(np.float64)
        tall = len(rows) > rows.shape[1]
        products = centered.T @ centered if tall else centered @ centered.T
        most = len(products)
        values, vectors = eigh(products, subset_by_index=[max(most - count, 0), most - 1])
        there = values > _ROUNDING * values[-1]
        directions = vectors[:, there]
        if not tall:
            directions = centered.T @ (directions / np.sqrt(values[there]))
        return Summaries(mean, directions.astype(np.float32), values[there] / len(rows))

    def __call__(self, rows: Rows) -> Floats:
        """Summaries (N, k) of rows (N, d)."""
        return ((rows - self.mean) @ self.directions).astype(np.float64)

    def unexplained(self, rows: Rows) -> Rows:
        """Residual of rows (N, d), in units of the noise, after removing components whose variance exceeds it."""
        centered, strong = rows - self.mean, self.directions[:, self.variances > 1]
        return np.asarray(centered - (centered @ strong) @ strong.T, dtype=np.float32)


class SummaryNoise(NamedTuple):
    """Normal distribution, with zero mean, of the noise in a recording's summaries."""

    root: Floats  # (k, k) root of its covariance
    span: float  # as `Noise.span`

    @staticmethod
    def of(noise: Noise, objective: Objective, table: Table, summaries: Summaries) -> SummaryNoise:
        """From the noise of recordings, of which summaries are linear functions."""
        m, k = objective.present.shape[1], summaries.directions.shape[1]
        projections = np.repeat(summaries.directions.reshape(-1, m, k) / table.block, table.block, axis=0)
        there, covariance = objective.present[: len(projections)], np.zeros((k, k))
        for column, (sd, rho) in enumerate(zip(noise.deviations / table.scale, noise.correlations, strict=True)):
            weights = sd * np.where(there[:, column, None], projections[:, column], 0.0)
            for rows in objective.frames:  # the transpose of the filter in `Noise.drawn`
                reacted = lfilter([1.0], [1.0, -rho], weights[rows][::-1], axis=0)[::-1].copy()
                reacted[1:] *= np.sqrt(1 - rho**2)
                covariance += reacted.T @ reacted
        values, vectors = eigh(covariance)
        return SummaryNoise(vectors * np.sqrt(np.maximum(values, 0.0)), noise.span)

    def scaled(self, scale: Floats) -> SummaryNoise:
        """The noise of summaries divided by a scale (k,)."""
        return self._replace(root=self.root / scale[:, None])

    def drawn(self, count: int, random: np.random.Generator) -> Floats:
        """Draws of the noise (count, k)."""
        sizes = self.span ** random.uniform(-1.0, 1.0, (count, 1))
        return sizes * random.standard_normal((count, len(self.root))) @ self.root.T
