"""Files of markers, and of forces and other readings, of any format, by their suffix; readings at frames."""

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

_FASTER = 0.75  # of a frame's interval: readings as far apart as frames, or hardly closer, do not alias
_READERS: dict[str, Callable[..., MarkerTrajectories]] = {".trc": read_trc, ".c3d": read_c3d, ".csv": read_marker_csv}


def read_markers(path: str | os.PathLike[str], *, units: str | None = None) -> MarkerTrajectories:
    """Marker trajectories from a TRC, C3D or CSV file, by its suffix.

    Args:
        path: the file.
        units: unit of length ("mm", "m", "cm") where the file has none.

    Raises:
        InputError: an unknown suffix, or what the format's reader refuses.
        MissingExtraError: a C3D file without the extra "c3d".
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"the suffix {suffix!r} is not known", where=path, expected=", ".join(_READERS))
    return _READERS[suffix](path, units=units)


def read_readings(path: str | os.PathLike[str]) -> Table:
    """Forces and other readings: the analog channels of a C3D file, or the columns of a CSV file; in SI units.

    A column without a unit has the unit "1".

    Raises:
        InputError: what `read_c3d_channels` or `read_csv` refuses.
        MissingExtraError: a C3D file without the extra "c3d".
    """
    return read_c3d_channels(path) if Path(path).suffix.lower() == ".c3d" else read_csv(path, units="1")


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
