"""Weights of residuals: weights of frames, and covariances of a channel's noise.

Residuals are multiplied by a matrix for each channel and a factor for each frame, so that their noise is white and of
equal size: r' = sqrt(w) s C^(-1/2) r for a frame of weight w (1 on average) and noise of covariance C, where s^2 is
the mean of C's diagonal. Objectives and covariances use r'; the residuals that are reported use the weights alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError

StatedNoise = Mapping[str, ArrayLike]  # by channel: a standard deviation, or a covariance of its columns

_SYMMETRIC = 1e-9  # largest asymmetry of a covariance, as a share of its largest element


class Metric(NamedTuple):
    """What residuals are multiplied by."""

    frames: Floats  # (n,) square roots of the weights
    channels: dict[str, Floats]  # (k, k) for channels whose noise has a covariance

    @staticmethod
    def of(weights: Floats | None, frames: int, stated: Mapping[str, Sequence[Sequence[float]]]) -> Metric | None:
        """From frames' weights (n,) and stated covariances; None if all residuals count equally."""
        made = {c: _whitening(np.asarray(value)) for c, value in stated.items()}
        if weights is None and not made:
            return None
        return Metric(np.ones(frames) if weights is None else np.sqrt(weights), made)

    def times(self, rows: Floats, channels: Iterable[tuple[str, slice]], *, transposed: bool = False) -> Floats:
        """Multiplies residuals or derivatives (N, n, m, k), whose columns belong to these channels."""
        out = rows * self.frames[:, None, None]
        for channel, columns in channels:
            if channel in self.channels:
                matrix = self.channels[channel]
                out[..., columns, :] = (matrix.T if transposed else matrix) @ out[..., columns, :]
        return out

    def at(self, frames: slice) -> Metric:
        """The metric of these frames alone."""
        return self._replace(frames=self.frames[frames])

    @staticmethod
    def joined(each: Sequence[Metric | None], lengths: Sequence[int]) -> Metric | None:
        """The metric of trials joined in sequence, with a frame of weight zero between two."""
        if not any(each):
            return None
        parts = [np.ones(n) if one is None else one.frames for one, n in zip(each, lengths, strict=True)]
        frames = np.concatenate([np.append(part, 0.0) for part in parts])[:-1]
        return Metric(frames, {c: matrix for one in each if one is not None for c, matrix in one.channels.items()})


def covariances(noise: StatedNoise | None) -> dict[str, list[list[float]]]:
    """The noise that was stated as a covariance, as plain numbers."""
    stated = {c: np.asarray(value, dtype=float) for c, value in (noise or {}).items()}
    return {c: value.tolist() for c, value in stated.items() if value.ndim == 2}


def level(value: ArrayLike) -> float:
    """Standard deviation of a noise; for a covariance the root mean square over its columns."""
    given = np.asarray(value, dtype=float)
    return float(given if given.ndim == 0 else np.sqrt(np.trace(given) / len(given)))


def check_noise(noise: StatedNoise, channels: Sequence[str], widths: Sequence[int]) -> None:
    """Checks the stated noise of these channels.

    Raises:
        InputError: if one is missing, not positive, or not a covariance of its columns.
    """
    for channel, width in zip(channels, widths, strict=True):
        if channel not in noise:
            expected = f"a standard deviation of: {', '.join(channels)}"
            raise InputError(f"no noise of {channel!r}", where="noise", expected=expected)
        value = np.asarray(noise[channel], dtype=float)
        expected = "a positive number" + (f", or a covariance ({width}, {width})" if width > 1 else "")
        if value.ndim == 0:
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{channel}: found {noise[channel]!r}", where="noise", expected=expected)
            continue
        if value.shape != (width, width) or width == 1:
            raise InputError(f"{channel}: found numbers of shape {value.shape}", where="noise", expected=expected)
        whole = np.isfinite(value).all() and np.abs(value - value.T).max() <= _SYMMETRIC * np.abs(value).max()
        if not whole or np.linalg.eigvalsh(value)[0] <= 0:
            found = f"{channel}: a matrix that is not a covariance"
            raise InputError(found, where="noise", expected="a symmetric matrix with positive eigenvalues")


def _whitening(covariance: Floats) -> Floats:
    """s C^(-1/2), from the Cholesky factor."""
    root = np.linalg.cholesky(covariance)
    return level(covariance) * solve_triangular(root, np.eye(len(root)), lower=True)
