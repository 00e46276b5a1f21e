"""Reads marker trajectories and analog channels from C3D files with ezc3d (the extra "c3d").

ezc3d may loop forever on damaged parameters, and silently shortens truncated files. So the chain of parameters is
checked first, and the length of the data section is compared with the header (layout: c3d.org user guide, "The C3D file
format").
"""

from __future__ import annotations

import math
import os
import struct
from typing import Any

import numpy as np

from pftwin.base.errors import InputError, MissingExtraError
from pftwin.base.text_files import read_bytes
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
    return from_file(times, labels, positions, path=path, unit_given=units is not None)


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


_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86


def check_c3d_structure(content: bytes, *, where: object) -> None:
    """Raises InputError for no C3D signature, damaged or incomplete parameters, or a truncated data section."""
    if len(content) < 2 or content[1] != 0x50 or content[0] < 1:
        raise InputError("the content is not C3D", where=where, expected="a C3D file (its second byte is 0x50)")
    start = (content[0] - 1) * _BLOCK
    if len(content) < start + 4:
        raise _truncated("its parameter section", where)
    processor = content[start + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise _damaged(where)
    order = ">" if processor == _MIPS else "<"
    counts = _walk_parameters(content, start + 4, order, where)
    if len(content) < 20:
        raise _truncated("its header", where)
    _check_channels(content, order, counts, where)
    if processor != _DEC:  # DEC's floats have their sign elsewhere
        _check_length(content, order, where)


def _walk_parameters(content: bytes, position: int, order: str, where: object) -> dict[tuple[bytes, bytes], int]:
    """Number of values of each parameter, by the names of its group and parameter."""
    groups: dict[int, bytes] = {}
    counts: dict[tuple[int, bytes], int] = {}
    while True:
        if position + 2 > len(content):
            raise _truncated("its parameter section", where)
        length, group = struct.unpack_from("2b", content, position)
        length = abs(length)
        if length == 0:
            break
        link = position + 2 + length
        if link + 2 > len(content):
            raise _truncated("its parameter section", where)
        step = struct.unpack_from(order + "h", content, link)[0]
        if group == 0 or step < 0 or any(byte < 32 for byte in content[position + 2 : link]):
            raise _damaged(where)
        name = content[position + 2 : link].upper()
        if group < 0:
            groups[-group] = name
        else:
            dimensions = content[link + 3 : link + 4] or b"\0"
            counts[group, name] = math.prod(content[link + 4 : link + 4 + dimensions[0]])
        last = step == 0
        _check_record(content, link + 2, len(content) if last else link + step, group, where)
        if last:
            break
        position = link + step
    if {group for group, _ in counts} - groups.keys():
        raise _damaged(where)
    return {(groups[group], name): count for (group, name), count in counts.items()}


def _check_channels(content: bytes, order: str, counts: dict[tuple[bytes, bytes], int], where: object) -> None:
    """Checks that every analog channel has a scale and an offset: ezc3d reads beyond the end of shorter lists."""
    (samples,), (each,) = (struct.unpack_from(order + "H", content, at) for at in (4, 18))
    channels = samples // max(each, 1)
    for key in (b"SCALE", b"OFFSET"):
        there = sum(
            n for (group, name), n in counts.items() if group == b"ANALOG" and name.rstrip(b"0123456789") == key
        )
        if there < channels and (b"SHADOW" not in {group for group, _ in counts}):
            found = f"{channels} analog channels, and {there} values of ANALOG:{key.decode()}"
            raise InputError(found, where=where, expected="one for each channel", remedy="export the file again")


def _check_record(content: bytes, begin: int, end: int, group: int, where: object) -> None:
    """Checks that the data and description of a group or parameter are within its record."""
    end = min(end, len(content))
    if group > 0:
        if begin + 2 > end:
            raise _damaged(where)
        kind, dimensions = struct.unpack_from("bB", content, begin)
        begin += 2 + dimensions
        # ezc3d crashes on a string without dimensions (a single character), which no known program writes.
        if kind not in (-1, 1, 2, 4) or not (kind == -1) <= dimensions <= 7 or begin > end:
            raise _damaged(where)
        begin += abs(kind) * math.prod(content[begin - dimensions : begin])
    if begin >= end or begin + 1 + content[begin] > end:
        raise _damaged(where)


def _damaged(where: object) -> InputError:
    return InputError("the parameter section of this C3D file is damaged", where=where, remedy="export it again")


def _check_length(content: bytes, order: str, where: object) -> None:
    points, analogs, first, last = struct.unpack_from(order + "4H", content, 2)
    (scale,) = struct.unpack_from(order + "f", content, 12)
    (block,) = struct.unpack_from(order + "H", content, 16)
    if last == 0xFFFF or last < first or block < 2:
        return  # more frames than the header can count: nothing to compare with
    frame = (4 * points + analogs) * (4 if scale < 0 else 2)
    wanted = (block - 1) * _BLOCK + (last - first + 1) * frame
    if len(content) < wanted:
        there = max(0, len(content) - (block - 1) * _BLOCK) // max(frame, 1)
        raise _truncated(f"frame {there} of {last - first + 1}", where)


def _truncated(place: str, where: object) -> InputError:
    return InputError(
        f"the C3D file breaks off in {place}: it is truncated", where=where, remedy="copy or export the file again"
    )
