"""Global heaps of an HDF5 file, walked before the library does: in a damaged one it goes round in circles for ever.

A heap (HDF5 File Format Specification 3.0, section III.E) is "GCOL", a version, its size, and objects one behind
the other, each with its own size. Where an object says that it takes no room the library (2.0) stays where it is,
inside of C, where no time limit of Python reaches it. Variables' dimensions are kept in such heaps.
"""

from __future__ import annotations

import mmap
from pathlib import Path

from pftwin.base.errors import InputError

_BEGIN = b"GCOL\x01\x00\x00\x00"
_HEADER = 16  # bytes, of a heap and of an object
_ALIGNED = 8


def check_heaps(file: Path) -> None:
    """Walks every global heap, objects to the end.

    Raises:
        InputError: one that does not end where it says, or an object that takes no room.
    """
    if not file.stat().st_size:
        return
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_BEGIN)
        while at >= 0:
            if not _whole(data, at):
                raise InputError(
                    f"cannot be read as NetCDF: the heap at byte {at} is damaged",
                    where=file,
                    expected="a result saved by pftwin",
                    remedy="copy the file again, or simulate again",
                )
            at = data.find(_BEGIN, at + len(_BEGIN))


def _whole(data: mmap.mmap, at: int) -> bool:
    size = int.from_bytes(data[at + 8 : at + _HEADER], "little")
    if not _HEADER <= size <= len(data) - at:
        return False
    place = _HEADER
    while size - place >= _HEADER:
        index = int.from_bytes(data[at + place : at + place + 2], "little")
        room = int.from_bytes(data[at + place + 8 : at + place + _HEADER], "little")
        # What is free counts its own header; an object does not, and is filled up.
        taken = room if index == 0 else _HEADER + -(-room // _ALIGNED) * _ALIGNED
        if not 0 < taken <= size - place:
            return False
        place += taken
    return True
