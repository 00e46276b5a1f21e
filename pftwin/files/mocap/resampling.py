"""Readings at the frames of a motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_FASTER = 0.75  # of a frame's interval: readings as far apart as frames, or hardly closer, do not alias


def frame_means(
    frames: NDArray[np.float64], times: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Readings at frames: the mean over one frame's interval about each, where readings are taken faster than frames.

    Picking single samples of a faster channel would fold what oscillates faster than the frames (hum of the mains, a
    cell that rings) into slow waves. The mean is centred, so it shifts nothing; it takes 1.6 % of a wave of a tenth of
    the frames' rate, 10 % of a quarter, and all of the rate itself and its multiples. At the ends of the recording the
    interval shrinks evenly on both sides. Slower readings are interpolated linearly.

    Args:
        frames: (n,) times [s] of the frames, increasing, within those of the readings; beyond, the last reading holds.
        times: (k,) times [s] of the readings, increasing.
        values: (k,) readings; a missing one (NaN) leaves the frames without a value whose interval holds it.

    Returns:
        (n,) values.
    """
    if frames.size < 2 or times.size < 2:
        return np.interp(frames, times, values)
    frame, reading = float(np.median(np.diff(frames))), float(np.median(np.diff(times)))
    if reading >= _FASTER * frame:
        return np.interp(frames, times, values)
    half = np.clip(np.minimum(frames - times[0], times[-1] - frames), 0.0, frame / 2)
    count = round(frame / reading)
    middles = (np.arange(count) + 0.5) / count * 2 - 1  # of as many equal parts of -1 to 1
    return np.interp(frames[:, None] + half[:, None] * middles, times, values).mean(axis=1)
