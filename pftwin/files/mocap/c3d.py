"""Marker trajectories from C3D files, read by ezc3d (the extra "c3d")."""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np

from pftwin.base.errors import InputError, MissingExtraError, PftwinWarning
from pftwin.base.text_files import read_bytes
from pftwin.files.mocap.c3d_structure import check_c3d_structure
from pftwin.files.mocap.markers import MarkerTrajectories, zeros_to_missing
from pftwin.files.mocap.units import check_spread, length_factor


def read_c3d(path: str | os.PathLike[str], *, units: str | None = None) -> MarkerTrajectories:
    """The 3D points of a C3D file.

    A point is missing (NaN) where its residual is negative, a coordinate is NaN, or all three are exactly 0 (older
    writers store missing points so, ezc3d issue 128). The first frame's time is that of the header's first frame.

    Args:
        path: the file.
        units: unit of length, for a file without POINT:UNITS or with a wrong one (a warning says where they differ).

    Raises:
        InputError: missing, empty, truncated or damaged file; no points; no rate; no, unknown or implausible unit.
        MissingExtraError: ezc3d is not installed.
    """
    check_c3d_structure(read_bytes(path), where=path)
    data = _load(path)
    parameters = data["parameters"].get("POINT", {})
    points = np.asarray(data["data"]["points"], dtype=np.float64)  # (4, m, n)
    if points.ndim != 3 or 0 in points.shape:
        raise InputError("the file holds no marker positions", where=path, expected="3D points")
    factor, differs = length_factor(_text(parameters, "UNITS"), units, where=f"{path}, POINT:UNITS")
    if differs:
        message = f"{path}: POINT:UNITS says {_text(parameters, 'UNITS')!r}; {units!r} is used as told"
        warnings.warn(message, PftwinWarning, stacklevel=2)
    positions = zeros_to_missing(np.transpose(points[:3], (2, 1, 0)) * factor)
    residuals = np.asarray(data["data"]["meta_points"]["residuals"], dtype=np.float64)  # (1, m, n)
    if residuals.shape[1:] == points.shape[1:]:
        positions[(residuals[0] < 0).T] = np.nan
    check_spread(positions, where=path)

    rate = float(data["header"]["points"]["frame_rate"])
    if not rate > 0:
        raise InputError(f"the sampling rate is {rate:g} Hz", where=f"{path}, POINT:RATE", expected="a positive rate")
    first = int(data["header"]["points"]["first_frame"])
    times = (first + np.arange(points.shape[2])) / rate
    return MarkerTrajectories(times, _labels(parameters, points.shape[1], path), positions, source=str(path))


def _load(path: str | os.PathLike[str]) -> Any:
    try:
        import ezc3d
    except ImportError as err:
        raise MissingExtraError("ezc3d", extra="c3d", feature="reading C3D files") from err
    try:
        return ezc3d.c3d(os.fspath(path))
    except (OSError, RuntimeError, ValueError, IndexError) as err:
        reason = str(err).splitlines()[0] if str(err) else type(err).__name__
        raise InputError(
            f"not a readable C3D file ({reason})", where=path, remedy="export the file again, or use TRC"
        ) from err


def _text(parameters: Any, key: str) -> str | None:
    values = parameters.get(key, {}).get("value", [])
    return str(values[0]).strip() or None if len(values) else None


def _labels(parameters: Any, count: int, path: object) -> tuple[str, ...]:
    labels: list[str] = []
    for key in ("LABELS", *(f"LABELS{i}" for i in range(2, 10))):  # 255 labels fit in one parameter
        labels += [str(v).strip() for v in parameters.get(key, {}).get("value", [])]
    if len(labels) < count or not all(labels[:count]):
        raise InputError(
            f"{len([v for v in labels if v])} labels for {count} points",
            where=f"{path}, POINT:LABELS",
            expected="a name for every point",
        )
    return tuple(labels[:count])
