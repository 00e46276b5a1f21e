"""Files of markers, and of forces and other readings, of any format, by their suffix."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from pftwin.base.errors import InputError
from pftwin.files.mocap.c3d import read_c3d, read_c3d_channels
from pftwin.files.mocap.csv_files import read_csv, read_marker_csv
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.tables import Table
from pftwin.files.mocap.trc import read_trc

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
