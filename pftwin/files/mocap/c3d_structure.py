"""Checks that bytes are a complete C3D file, before ezc3d reads it.

ezc3d may loop forever on damaged parameters, and silently shortens truncated files. So the chain of parameters is
checked first, and the length of the data section is compared with the header (layout: c3d.org user guide, "The C3D file
format").
"""

from __future__ import annotations

import math
import struct

from pftwin.base.errors import InputError

_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86


def check_c3d_structure(content: bytes, *, where: object) -> None:
    """Checks that bytes are a complete C3D file.

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
