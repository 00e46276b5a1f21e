"""A batch's folder: `batch.json`, which says what batch it is, and a NetCDF file for each unit of it that is done.

    batch.json        key and features of the batch, its units
    part_00000.nc     members of the first unit, as `simulate_batch` gives them, with key, number and checksum
    part_00001.nc     ...

Every file appears whole or not at all (`pftwin.base.output.written_whole`), and no file is ever changed.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.output import make_folder, remove_unfinished
from pftwin.base.text_files import read_json, write_text

if TYPE_CHECKING:
    from xarray import Dataset

NAME = "batch.json"
FORMAT = "pftwin batch in parts 1"
_EXPECTED = f"a file of {FORMAT!r}, as pftwin.simulate_batch writes it"
_UNFINISHED = re.compile(r"^\.(?:batch\.[a-z0-9_]{8}\.json|part_\d+\.[a-z0-9_]{8}\.nc)$")
_LEFT = 3600.0  # [s] since the last write, after which an unfinished file counts as abandoned
SHOWN = 60.0  # [s] that a network file system may take to show one machine what another has written
MARKS = ("part_key", "part", "part_sha256")  # attributes that a part's file has and a batch has not
_ANEW = "the same call again recomputes this part; delete it first if it comes from elsewhere"


class BatchIndex(NamedTuple):
    """The content of `batch.json`."""

    key: str
    features: dict[str, str]
    units: list[int]  # members of each


def part_file(folder: Path, unit: int) -> Path:
    """Where a unit's members are."""
    return folder / f"part_{unit:05d}.nc"


def prepare_folder(folder: Path, index: BatchIndex) -> None:
    """Makes the folder ready for a batch, which may have been begun before.

    Raises:
        InputError: it holds another batch, or parts of which nobody says what they are.
        OutputError: it cannot be made or written to.
    """
    make_folder(folder)
    if (folder / NAME).exists():
        there = read_index(folder)
        if there.key != index.key:
            other = [k for k in index.features if there.features.get(k) != index.features[k]]
            raise InputError(
                f"holds parts of another batch, with other {' and '.join(other) or 'features'}",
                where=folder,
                expected="an empty folder, or parts of this batch",
                remedy="another folder for this batch",
            )
    elif any(folder.glob("part_*.nc")):
        raise InputError(
            f"holds parts and no {NAME}",
            where=folder,
            expected="an empty folder, or one that pftwin.simulate_batch wrote",
            remedy="another folder",
        )
    else:
        content = {"format": FORMAT, **index._asdict()}
        write_text(folder / NAME, json.dumps(content, indent=1) + "\n")
    remove_unfinished(folder, _UNFINISHED, older=_LEFT)


def check_seen(folder: Path, index: BatchIndex, wait: float) -> None:
    """Refuses a folder that is not the one which another process has begun, before anything is computed.

    Raises:
        InputError: the batch is not in it, or does not appear within `wait` [s].
    """
    _await(folder / NAME, wait)
    if not (folder / NAME).is_file() or read_index(folder).key != index.key:
        raise InputError(
            "holds nothing of what process 0 has just written",
            where=folder,
            expected="a folder on a disk that all processes see",
        )


def read_index(folder: Path) -> BatchIndex:
    """What batch a folder is of.

    Raises:
        InputError: it does not say.
    """
    path = folder / NAME
    content = read_json(path, expected=_EXPECTED)
    try:
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {content['format']!r}")
        features = {str(k): str(v) for k, v in content["features"].items()}
        return BatchIndex(str(content["key"]), features, [int(n) for n in content["units"]])
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"not a batch: {error}", where=path, expected=_EXPECTED, remedy="another folder") from None


def write_part(folder: Path, unit: int, key: str, members: Dataset) -> None:
    """Writes a unit's members.

    Raises:
        OutputError: the disk is full, or the folder cannot be written to.
    """
    from pftwin.files.result_files import save_dataset

    marks = dict(zip(MARKS, (key, unit, checksum(members)), strict=True))
    save_dataset(members.assign_attrs(marks), part_file(folder, unit))


def read_part(folder: Path, unit: int, index: BatchIndex, wait: float = 0.0, like: Dataset | None = None) -> Dataset:
    """A unit's members; its file may take the time `wait` to appear [s].

    `like` is another part, most likely with the same variables: what need not be looked up makes reading fast.

    Raises:
        InputError: it is not there, damaged, or of another batch.
    """
    from pftwin.files.result_files import load_dataset

    path = part_file(folder, unit)
    _await(path, wait)
    if like is not None and path.is_file():
        found = numbers_like(like, path)
        if found is not None and _fault(found, unit, index) is None:
            return _unmarked(found)
    found = load_dataset(path)
    if wrong := _fault(found, unit, index):
        raise InputError(wrong, where=path, remedy=_ANEW)
    return _unmarked(found)


def _fault(found: Dataset, unit: int, index: BatchIndex) -> str | None:
    if found.attrs.get("part_key") != index.key or found.attrs.get("part") != unit:
        return "belongs to another batch, or to another place in it"
    if found.sizes.get("variant") != index.units[unit] or found.attrs.get("part_sha256") != checksum(found):
        return "its numbers are not those that were written"
    return None


def _unmarked(found: Dataset) -> Dataset:
    found.attrs = {k: v for k, v in found.attrs.items() if k not in MARKS}
    return found


def _await(path: Path, wait: float) -> None:
    until = time.monotonic() + wait
    while not path.is_file() and time.monotonic() < until:
        time.sleep(0.1)
        if path.parent.is_dir():
            list(path.parent.iterdir())  # has a network file system look again


def checksum(data: Dataset) -> str:
    """A hash of all names, shapes and numbers, however a file packs them."""
    total = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        variable = data[name].variable
        values = np.asarray(variable.values)
        total.update(repr((name, variable.dims, values.shape)).encode())
        if values.dtype.kind in "OU":
            total.update(json.dumps(values.ravel().tolist()).encode())
        else:
            total.update(values.dtype.str.encode() + np.ascontiguousarray(values).tobytes())
    return total.hexdigest()


def numbers_like(like: Dataset, path: Path) -> Dataset | None:
    """A file's members, as a dataset with the variables, units and attributes of another one.

    xarray takes a fifth of a second to learn what a file holds, ten times what the numbers take. Whether it was right
    to expect the same again, the checksum says: None, or another checksum, and it has to be read in full.

    Raises:
        InputError: a file that is too large, or damaged where `check_netcdf` looks.
    """
    import h5py
    from xarray import Dataset

    from pftwin.files.netcdf_check import check_netcdf

    check_netcdf(path)
    try:
        with h5py.File(path, "r") as file:
            own = {n: v for n, v in like.variables.items() if v.dims[:1] == ("variant",)}
            read = {n: v.copy(data=_values(file[str(n)], v.dtype)) for n, v in own.items()}
            marks = {name: np.asarray(file.attrs[name]).item() for name in MARKS}
    except (KeyError, ValueError, TypeError, OSError, RuntimeError):  # other variables, or a damaged file
        return None
    whole = {n: read.get(n, v) for n, v in like.variables.items()}
    data = {n: v for n, v in whole.items() if n not in like.coords}
    return Dataset(data, {n: whole[n] for n in like.coords}, {**like.attrs, **marks})


def _values(variable: Any, kind: np.dtype[Any]) -> np.ndarray[Any, Any]:
    if kind.kind == "U":
        return np.array(variable.asstr()[()].tolist(), dtype=str)
    return variable[()].astype(kind, copy=False)
