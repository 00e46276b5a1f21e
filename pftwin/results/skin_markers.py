"""Comparison of measured and simulated time courses of skin markers over the patella, without absolute position."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError

_FEWEST = 3  # measured frames that a comparison needs
# Shown wherever measured and simulated time courses of a skin marker are compared.
QUALITATIVE = (
    "a marker on the skin is qualitative: skin slides over the bone, so its course can be compared, not its place"
)


class Reading(NamedTuple):
    """An observable of an effect over the frames, in a display unit."""

    values: NDArray[np.float64]  # (n,) in the display unit
    scale: float  # factor from the effect's unit to the display unit
    unit: str  # display unit
    words: str  # long name


class SkinMarker(NamedTuple):
    """Agreement of the measured and the simulated time course of one coordinate of a skin marker."""

    key: str  # "EFFECT.x"
    unit: str
    words: str  # long name of the coordinate
    correlation: float | None  # Pearson correlation; None if either course is constant
    measured_range: float  # maximum minus minimum over the measured frames
    simulated_range: float
    rms_about_mean: float  # standard deviation of the difference: its RMS after subtraction of the mean
    frames: int  # number of measured frames

    @staticmethod
    def of(key: str, simulated: Reading, measured: NDArray[np.float64], source: str) -> SkinMarker:
        """Compares two time courses (n,); `measured` is in the effect's unit, NaN in frames without a measurement.

        Raises:
            InputError: fewer than three frames were measured.
        """
        present = np.isfinite(measured)
        count = int(np.count_nonzero(present))
        if count < _FEWEST:
            raise InputError(f"{key} was measured in {count} frames", where=source, expected=f"{_FEWEST} or more")
        ours, theirs = simulated.values[present], simulated.scale * measured[present]
        changing = np.ptp(ours) > 0 and np.ptp(theirs) > 0
        alike = float(np.corrcoef(ours, theirs)[0, 1]) if changing else None
        ranges = float(np.ptp(theirs)), float(np.ptp(ours))
        off = float(np.std(ours - theirs))
        return SkinMarker(key, simulated.unit, simulated.words, alike, *ranges, off, count)
