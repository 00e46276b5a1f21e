"""Reads markers, and forces and other readings, from any format by the file's suffix; resamples readings at frames."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.c3d import read_c3d, read_c3d_channels
from pftwin.files.mocap.csv_files import read_csv, read_marker_csv
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.tables import Table
from pftwin.files.mocap.trc import read_trc

_FASTER = 0.75  # share of a frame's interval; readings with longer intervals are interpolated, since they hardly alias
_READERS: dict[str, Callable[..., MarkerTrajectories]] = {".trc": read_trc, ".c3d": read_c3d, ".csv": read_marker_csv}


def read_markers(path: str | os.PathLike[str], *, units: str | None = None) -> MarkerTrajectories:
    """Reads marker trajectories from a TRC, C3D or CSV file, by its suffix.

    Args:
        path: the file.
        units: unit of length ("mm", "m", "cm") if the file has none.

    Raises:
        InputError: an unknown suffix, or as the format's reader.
        MissingExtraError: a C3D file without the extra "c3d".
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"the suffix {suffix!r} is not known", where=path, expected=", ".join(_READERS))
    return _READERS[suffix](path, units=units)


def read_readings(path: str | os.PathLike[str]) -> Table:
    """Reads forces and other readings from the analog channels of a C3D file or the columns of a CSV file.

    They are converted to SI units; a column without a unit has the unit "1".

    Raises:
        InputError: as `read_c3d_channels` or `read_csv`.
        MissingExtraError: a C3D file without the extra "c3d".
    """
    return read_c3d_channels(path) if Path(path).suffix.lower() == ".c3d" else read_csv(path, units="1")


def frame_means(
    frames: NDArray[np.float64], times: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Resamples readings at frames: the mean over the interval of a frame around each, if readings are faster.

    Single samples of a faster channel would alias oscillations above the frame rate (mains hum, a ringing load cell).
    The mean is centred and causes no delay; it attenuates waves of a tenth of the frame rate by 1.6 %, of a quarter by
    10 %, and of the frame rate and its multiples completely. At the ends of the recording the interval shrinks on both
    sides. Slower readings are interpolated linearly.

    Args:
        frames: (n,) times [s] of the frames, increasing, within those of the readings; beyond, the end value is used.
        times: (k,) times [s] of the readings, increasing.
        values: (k,) readings; frames whose interval contains a missing one (NaN) have no value (NaN).

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
    middles = (np.arange(count) + 0.5) / count * 2 - 1  # midpoints of `count` equal parts of [-1, 1]
    return np.interp(frames[:, None] + half[:, None] * middles, times, values).mean(axis=1)
