"""Markers on the skin over the patella: how alike a measured and a simulated course are, and nothing of their place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError

_FEWEST = 3  # frames of which a course can be told
# Said wherever measured and simulated courses of a marker on the skin stand side by side.
QUALITATIVE = (
    "a marker on the skin is qualitative: skin slides over the bone, so its course can be compared, not its place"
)


class SkinMarker(NamedTuple):
    """A coordinate of a marker on the skin over the patella: how like its course is to the simulated one."""

    key: str  # "EFFECT.x"
    unit: str
    words: str  # what the coordinate is
    correlation: float | None  # Pearson's; None where either does not change
    measured_range: float  # largest less smallest, over the frames in which it was measured
    simulated_range: float
    rms_about_mean: float  # root mean square difference, less the mean one
    frames: int  # in which it was measured

    @staticmethod
    def of(
        key: str,
        words: str,
        unit: str,
        simulated: NDArray[np.float64],
        measured: NDArray[np.float64],
        source: str,
    ) -> SkinMarker:
        """Of both courses (n,) in this unit; the measured one is NaN in frames without a measurement.

        Raises:
            InputError: fewer than three frames in which it was measured.
        """
        there = np.isfinite(measured)
        count = int(np.count_nonzero(there))
        if count < _FEWEST:
            raise InputError(f"{key} was measured in {count} frames", where=source, expected=f"{_FEWEST} or more")
        ours, theirs = simulated[there], measured[there]
        changing = np.ptp(ours) > 0 and np.ptp(theirs) > 0
        alike = float(np.corrcoef(ours, theirs)[0, 1]) if changing else None
        ranges = float(np.ptp(theirs)), float(np.ptp(ours))
        return SkinMarker(key, unit, words, alike, *ranges, float(np.std(ours - theirs)), count)
