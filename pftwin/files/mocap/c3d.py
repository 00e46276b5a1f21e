"""Reads marker trajectories and analog channels from C3D files with ezc3d (the extra "c3d")."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from pftwin.base.errors import InputError, MissingExtraError
from pftwin.base.text_files import read_bytes
from pftwin.files.mocap.c3d_structure import check_c3d_structure
from pftwin.files.mocap.markers import MarkerTrajectories, from_file
from pftwin.files.mocap.tables import Table
from pftwin.files.mocap.units import known_unit, length_factor


def read_c3d(path: str | os.PathLike[str], *, units: str | None = None) -> MarkerTrajectories:
    """Reads the 3D points of a C3D file.

    A point is missing (NaN) if its residual is negative, a coordinate is NaN, or all three are exactly 0 (as older
    writers store missing points, ezc3d issue 128). The first frame's time is that of the header's first frame.

    Args:
        path: the file.
        units: unit of length, for a file without POINT:UNITS or with a wrong one (with a warning if they differ).

    Raises:
        InputError: missing, empty, truncated or damaged file; no points; no rate; no, unknown or implausible unit.
        MissingExtraError: ezc3d is not installed.
    """
    data = _load(path)
    parameters = data["parameters"].get("POINT", {})
    points = np.asarray(data["data"]["points"], dtype=np.float64)  # (4, m, n)
    if points.ndim != 3 or 0 in points.shape:
        raise InputError("the file holds no marker positions", where=path, expected="3D points")
    factor = length_factor(_text(parameters, "UNITS"), units, where=f"{path}, POINT:UNITS")
    positions = np.transpose(points[:3], (2, 1, 0)) * factor
    residuals = np.asarray(data["data"]["meta_points"]["residuals"], dtype=np.float64)  # (1, m, n)
    if residuals.shape[1:] == points.shape[1:]:
        positions[(residuals[0] < 0).T] = np.nan
    times = _times(data, "POINT", points.shape[2], path)
    labels = _texts(parameters, "LABELS", points.shape[1])
    if not all(labels):
        found = f"{len([v for v in labels if v])} labels for {len(labels)} points"
        raise InputError(found, where=f"{path}, POINT:LABELS", expected="a name for every point")
    return from_file(times, labels, positions, path=path, told=units is not None)


def read_c3d_channels(path: str | os.PathLike[str]) -> Table:
    """Reads the analog channels of a C3D file (load cells, force plates), in SI units, at their own rate.

    Each channel's offset and scale are applied. Columns are named by the channels' labels, or "channel 7" (from 1)
    without a label, with the units of ANALOG:UNITS. Values in an unknown unit (mV/V) are not converted and keep it; a
    missing unit is "1". The first sample's time is that of the header's first frame.

    Raises:
        InputError: missing, empty, truncated or damaged file; no channels; no rate; two channels with the same label.
        MissingExtraError: ezc3d is not installed.
    """
    data = _load(path)
    parameters = data["parameters"].get("ANALOG", {})
    samples = np.asarray(data["data"]["analogs"], dtype=np.float64)  # (1, k, n)
    if samples.ndim != 3 or 0 in samples.shape:
        raise InputError("the file holds no analog data", where=path, expected="analog channels")
    times = _times(data, "ANALOG", samples.shape[2], path)
    columns = _corrected_channels(samples[0].T, data["parameters"])
    labels = _texts(parameters, "LABELS", samples.shape[1])
    names = tuple(label or f"channel {i}" for i, label in enumerate(labels, start=1))
    units = {}
    for i, (name, unit) in enumerate(zip(names, _texts(parameters, "UNITS", len(names)), strict=True)):
        units[name], factor = known_unit(unit or "1") or (unit, 1.0)
        columns[:, i] *= factor
    return Table(times, names, columns, units, source=str(path))


def _corrected_channels(samples: np.ndarray, parameters: Any) -> np.ndarray:
    """Channels (n, k) as (integer - offset) * scale; ezc3d reads offsets as unsigned, and integers as signed."""

    def of(key: str, default: float) -> np.ndarray:
        values = [float(v) for v in _values(parameters["ANALOG"], key)]
        return np.array((values + [default] * samples.shape[1])[: samples.shape[1]])

    step, offset = of("SCALE", 1.0) * of("GEN_SCALE", 1.0)[0], of("OFFSET", 0.0)
    unsigned = (_text(parameters["ANALOG"], "FORMAT") or "").upper() == "UNSIGNED"
    out = samples + (np.abs(offset) - (offset % 2**16 if unsigned else offset)) * step
    in_floats = np.ravel(parameters["POINT"].get("SCALE", {}).get("value", [-1.0]))[0] < 0
    if unsigned and not in_floats:
        integers = samples / np.where(step == 0, 1.0, step) + np.abs(offset)
        out += np.where(integers < -0.5, 2**16 * step, 0.0)
    return out


def _load(path: str | os.PathLike[str]) -> Any:
    check_c3d_structure(read_bytes(path), where=path)
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


def _values(parameters: Any, key: str) -> list[Any]:
    """Values of a list: up to 255 are in parameter KEY, more in KEY2 to KEY9."""
    names = (key, *(f"{key}{i}" for i in range(2, 10)))
    return [v for name in names for v in parameters.get(name, {}).get("value", [])]


def _texts(parameters: Any, key: str, count: int) -> tuple[str, ...]:
    """One string for each of `count` points or channels; empty if there is none."""
    texts = [str(v).strip() for v in _values(parameters, key)]
    return tuple((texts + [""] * count)[:count])


def _times(data: Any, group: str, count: int, path: object) -> np.ndarray:
    """Times (n,) [s] of points or samples."""
    header = data["header"]["points" if group == "POINT" else "analogs"]
    rate = float(header["frame_rate"])
    if not rate > 0:
        raise InputError(f"the sampling rate is {rate:g} Hz", where=f"{path}, {group}:RATE", expected="a positive rate")
    return (int(header["first_frame"]) + np.arange(count)) / rate
