"""Marker trajectories from C3D files, read by ezc3d (the extra "c3d").

ezc3d may loop for ever on damaged parameters, and shortens truncated files without a warning. So the chain of
parameters is walked first, and the length of the data section is compared with the header (layout: c3d.org user guide,
"The C3D file format").
"""

from __future__ import annotations

import math
import os
import struct
import warnings
from typing import Any

import numpy as np

from pftwin.base.errors import InputError, MissingExtraError, PftwinWarning
from pftwin.base.text_files import read_bytes
from pftwin.files.mocap.markers import MarkerTrajectories, zeros_to_missing
from pftwin.files.mocap.units import check_jumps, check_spread, length_factor


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
    check_spread(positions, where=path, told=units is not None)

    rate = float(data["header"]["points"]["frame_rate"])
    if not rate > 0:
        raise InputError(f"the sampling rate is {rate:g} Hz", where=f"{path}, POINT:RATE", expected="a positive rate")
    first = int(data["header"]["points"]["first_frame"])
    times = (first + np.arange(points.shape[2])) / rate
    markers = MarkerTrajectories(times, _labels(parameters, points.shape[1], path), positions, source=str(path))
    check_jumps(markers.positions, markers.times, markers.names, where=path)
    return markers


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


_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86


def check_c3d_structure(content: bytes, *, where: object) -> None:
    """Refuse bytes that are not a whole C3D file.

    Raises:
        InputError: no C3D signature, a damaged or incomplete parameter section, a truncated data section.
    """
    if len(content) < 2 or content[1] != 0x50 or content[0] < 1:
        raise InputError("the content is not C3D", where=where, expected="a C3D file (its second byte is 0x50)")
    start = (content[0] - 1) * _BLOCK
    if len(content) < start + 4:
        raise _truncated("its parameter section", where)
    processor = content[start + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise _damaged(where)
    order = ">" if processor == _MIPS else "<"
    _walk_parameters(content, start + 4, order, where)
    if processor != _DEC:  # the sign of DEC's float is elsewhere
        _check_length(content, order, where)


def _walk_parameters(content: bytes, position: int, order: str, where: object) -> None:
    groups, used = set(), set()
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
        (groups if group < 0 else used).add(abs(group))
        last = step == 0
        _check_record(content, link + 2, len(content) if last else link + step, group, where)
        if last:
            break
        position = link + step
    if used - groups:
        raise _damaged(where)


def _check_record(content: bytes, begin: int, end: int, group: int, where: object) -> None:
    """A group's or parameter's data and description lie within its record."""
    end = min(end, len(content))
    if group > 0:
        if begin + 2 > end:
            raise _damaged(where)
        kind, dimensions = struct.unpack_from("bB", content, begin)
        begin += 2 + dimensions
        # ezc3d crashes on a text without dimensions, a single character, which no program is known to write.
        if kind not in (-1, 1, 2, 4) or not (kind == -1) <= dimensions <= 7 or begin > end:
            raise _damaged(where)
        begin += abs(kind) * math.prod(content[begin - dimensions : begin])
    if begin >= end or begin + 1 + content[begin] > end:
        raise _damaged(where)


def _damaged(where: object) -> InputError:
    return InputError("the parameter section of this C3D file is damaged", where=where, remedy="export it again")


def _check_length(content: bytes, order: str, where: object) -> None:
    if len(content) < 20:
        raise _truncated("its header", where)
    points, analogs, first, last = struct.unpack_from(order + "4H", content, 2)
    (scale,) = struct.unpack_from(order + "f", content, 12)
    (block,) = struct.unpack_from(order + "H", content, 16)
    if last == 0xFFFF or last < first or block < 2:
        return  # a longer recording than the header can count: nothing to compare with
    frame = (4 * points + analogs) * (4 if scale < 0 else 2)
    wanted = (block - 1) * _BLOCK + (last - first + 1) * frame
    if len(content) < wanted:
        there = max(0, len(content) - (block - 1) * _BLOCK) // max(frame, 1)
        raise _truncated(f"frame {there} of {last - first + 1}", where)


def _truncated(place: str, where: object) -> InputError:
    return InputError(
        f"the C3D file breaks off in {place}: it is truncated", where=where, remedy="copy or export the file again"
    )
