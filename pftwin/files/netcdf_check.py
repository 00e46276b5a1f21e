"""Safety checks of a NetCDF-4 file before it is read: the size of its variables, and that the file contains their data.

HDF5 allows a file of a few kilobytes to declare variables of any size (unwritten parts are filled in), to compress
zeros a thousandfold, and to read data from other files. Files written by pftwin do none of this.

First the global heaps, which store the variables' dimensions, are checked. A heap (HDF5 File Format Specification 3.0,
section III.E) consists of "GCOL", a version, its size, and a sequence of objects, each with its size. At an object of
size zero the library (2.0) enters an endless loop in C code, which no time limit in Python can stop.
"""

from __future__ import annotations

import math
import mmap
from pathlib import Path
from typing import Any

import h5py

from pftwin.base.errors import InputError
from pftwin.base.text_files import RESULT_BYTES, RESULT_PACKED, RESULT_SMALL

_SAVED = "a result saved by pftwin"
_AGAIN = "copy the file again, or simulate again"


def check_netcdf(file: Path) -> list[str]:
    """Checks a file, and returns the names of its groups.

    Raises InputError if it is too large, packed or unpacked, refers to other files, or is not NetCDF-4.
    """
    size = file.stat().st_size
    if size > RESULT_BYTES:
        raise _too_large(f"{size / 1e9:.1f} GB", file)
    check_heaps(file)
    try:
        with h5py.File(file, "r") as opened:
            total = [0]
            # A returned value ends the visit. Do not raise: an exception does not survive its way through HDF5.
            wrong = opened.visititems_links(
                lambda name, link: None if isinstance(link, h5py.HardLink) else _external_reference_error(name, file)
            )
            wrong = wrong or opened.visititems(lambda name, item: _in_item(item, name, file, total))
            if wrong is not None:
                raise wrong
            return [name for name, item in opened.items() if isinstance(item, h5py.Group)]
    except InputError:
        raise
    except Exception as error:  # the library raises whatever its parsing of a damaged file runs into
        raise not_netcdf(file, error) from error


def _in_item(item: Any, name: str, file: Path, total: list[int]) -> InputError | None:
    if not isinstance(item, h5py.Dataset):
        return None
    if item.external or item.is_virtual:
        return _external_reference_error(name, file)
    announced, there = item.nbytes, item.id.get_storage_size()
    total[0] += announced
    # A chunk is always unpacked as a whole.
    chunk = 0 if item.chunks is None else math.prod(map(int, (item.dtype.itemsize, *item.chunks)))
    if total[0] > RESULT_BYTES or chunk > RESULT_BYTES:
        return _too_large(f"{max(total[0], chunk) / 1e9:.1f} GB of variables", file)
    if max(announced, chunk) > max(RESULT_SMALL, RESULT_PACKED * there):
        found = f"announces {max(announced, chunk) / 1e6:.0f} MB, of which the file holds {there / 1e6:.1f}"
        return InputError(f"{name!r} {found}", where=file, expected=_SAVED, remedy=_AGAIN)
    return None


def _external_reference_error(name: str, file: Path) -> InputError:
    return InputError(f"{name!r} is stored in another file", where=file, expected=f"{_SAVED}, which is a single file")


def _too_large(found: str, file: Path) -> InputError:
    return InputError(
        f"{found} are too large",
        where=file,
        expected=f"at most {RESULT_BYTES / 1e9:.0f} GB",
        remedy="fewer variants or frames a file",
    )


def not_netcdf(file: Path, error: Exception) -> InputError:
    """The error for a file that a NetCDF library cannot read."""
    return InputError(f"cannot be read as NetCDF: {error}", where=file, expected=_SAVED)


_BEGIN = b"GCOL\x01\x00\x00\x00"
_HEADER = 16  # size of a heap's and of an object's header [bytes]
_ALIGNED = 8


def check_heaps(file: Path) -> None:
    """Raises InputError for a global heap that does not end where its size says, or with an object of size zero."""
    if not file.stat().st_size:
        return
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_BEGIN)
        while at >= 0:
            if not _whole(data, at):
                found = f"cannot be read as NetCDF: the heap at byte {at} is damaged"
                raise InputError(found, where=file, expected=_SAVED, remedy=_AGAIN)
            at = data.find(_BEGIN, at + len(_BEGIN))


def _whole(data: mmap.mmap, at: int) -> bool:
    size = int.from_bytes(data[at + 8 : at + _HEADER], "little")
    if not _HEADER <= size <= len(data) - at:
        return False
    place = _HEADER
    while size - place >= _HEADER:
        index = int.from_bytes(data[at + place : at + place + 2], "little")
        room = int.from_bytes(data[at + place + 8 : at + place + _HEADER], "little")
        # The size of the free space includes its header; that of an object does not, and is padded.
        taken = room if index == 0 else _HEADER + -(-room // _ALIGNED) * _ALIGNED
        if not 0 < taken <= size - place:
            return False
        place += taken
    return True
