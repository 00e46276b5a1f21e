"""The folder of a batch in parts: `batch.json`, which identifies it, and a NetCDF file per completed unit.

    batch.json        key and features of the batch, its units
    part_00000.nc     variants of the first unit as from `simulate_batch`, with key, number and checksum
    part_00001.nc     ...

Files are written atomically (`pftwin.base.output.written_whole`) and never changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.output import make_folder, remove_unfinished
from pftwin.base.text_files import read_json, shortened_list, write_text

if TYPE_CHECKING:
    from xarray import Dataset

NAME = "batch.json"
FORMAT = "pftwin batch in parts 1"
_EXPECTED = f"a file of {FORMAT!r}, as pftwin.simulate_batch writes it"
_UNFINISHED = re.compile(r"^\.(?:batch\.[a-z0-9_]{8}\.json|part_\d+\.[a-z0-9_]{8}\.nc)$")
_LEFT = 3600.0  # time since the last write after which a temporary file counts as abandoned [s]
SHOWN = 60.0  # time that a network file system may take to show a file to other machines [s]
MARKS = ("part_key", "part", "part_sha256")  # attributes that only a part's file has
_ANEW = "the same call again recomputes this part; delete it first if it comes from elsewhere"
_NAMED = 5  # largest number of parts listed in a message


class BatchIndex(NamedTuple):
    """The content of `batch.json`."""

    key: str
    features: dict[str, str]
    units: list[int]  # number of variants in each


def part_file(folder: Path, unit: int) -> Path:
    """Path of a unit's file."""
    return folder / f"part_{unit:05d}.nc"


def prepare_folder(folder: Path, index: BatchIndex) -> None:
    """Prepares the folder of a new batch, or of one that was started before.

    Raises:
        InputError: it contains another batch, or parts without a `batch.json`.
        OutputError: it cannot be created or written to.
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


def check_shared_folder(folder: Path, index: BatchIndex, wait: float) -> None:
    """Checks that this process sees the folder that another process has prepared.

    Raises:
        InputError: the batch does not appear in the folder within `wait` [s].
    """
    _await(folder / NAME, wait)
    if not (folder / NAME).is_file() or read_index(folder).key != index.key:
        raise InputError(
            "does not contain the batch that process 0 has just prepared",
            where=folder,
            expected="a folder on a disk shared by all processes",
        )


def read_index(folder: Path) -> BatchIndex:
    """Reads `batch.json` of a folder.

    Raises:
        InputError: the file is missing or invalid.
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
    """Writes the variants of a unit.

    Raises:
        OutputError: the disk is full, or the folder is not writable.
    """
    from pftwin.files.result_files import save_dataset

    marks = dict(zip(MARKS, (key, unit, checksum(members)), strict=True))
    save_dataset(members.assign_attrs(marks), part_file(folder, unit))


def read_part(folder: Path, unit: int, index: BatchIndex, wait: float = 0.0) -> Dataset:
    """Reads the variants of a unit, waiting up to `wait` [s] for its file.

    Raises:
        InputError: the file is missing, damaged, or belongs to another batch.
    """
    from pftwin.files.result_files import load_dataset

    path = part_file(folder, unit)
    _await(path, wait)
    found = load_dataset(path)
    if found.attrs.get("part_key") != index.key or found.attrs.get("part") != unit:
        raise InputError("belongs to another batch, or to another place in it", where=path, remedy=_ANEW)
    if found.sizes.get("variant") != index.units[unit] or found.attrs.get("part_sha256") != checksum(found):
        raise InputError("its numbers are not those that were written", where=path, remedy=_ANEW)
    found.attrs = {k: v for k, v in found.attrs.items() if k not in MARKS}
    return found


def _await(path: Path, wait: float) -> None:
    until = time.monotonic() + wait
    while not path.is_file() and time.monotonic() < until:
        time.sleep(0.1)
        if path.parent.is_dir():
            list(path.parent.iterdir())  # makes a network file system refresh


def checksum(data: Dataset) -> str:
    """Hash of all names, shapes and values of a dataset, independent of a file's compression."""
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


def read_parts(folder: str | os.PathLike[str], *, incomplete: bool = False) -> Dataset:
    """Reads the dataset of a batch from `pftwin.simulate_batch(..., parts=folder)`, also while it runs.

    Args:
        folder: folder of the parts.
        incomplete: whether to read only the existing parts; `variant` then identifies the variants.

    Returns:
        The dataset, as from `simulate_batch`.

    Raises:
        InputError: the folder contains no batch, or parts are missing or damaged: any part or, with `incomplete`, all.
    """
    place = Path(folder)
    index = read_index(place)
    there, wrong = _read_parts(place, index)
    if wrong and not (incomplete and there):
        first = next(iter(wrong.values()))
        named = shortened_list((part_file(place, u).name for u in wrong), _NAMED)
        raise InputError(
            f"{len(wrong)} of {len(index.units)} parts are missing or damaged: {named} ({first})",
            where=place,
            remedy="simulate_batch again with the same folder: it computes only these"
            + ("; or incomplete=True for the others" if there else ""),
        )
    return concatenated_parts(list(there.values()))


def missing_parts(folder: str | os.PathLike[str]) -> dict[int, str]:
    """Units of a batch that remain to be computed, each with the reason. Reads all parts.

    Raises:
        InputError: the folder contains no batch.
    """
    place = Path(folder)
    return _read_parts(place, read_index(place))[1]


def _read_parts(folder: Path, index: BatchIndex) -> tuple[dict[int, Dataset], dict[int, str]]:
    there: dict[int, Dataset] = {}
    wrong: dict[int, str] = {}
    for unit in range(len(index.units)):
        try:
            there[unit] = read_part(folder, unit, index)
        except InputError as error:
            wrong[unit] = str(error)
    return there, wrong


def concatenated_parts(parts: Sequence[Dataset]) -> Dataset:
    """Concatenates the variants of several units, in the order of the batch."""
    from xarray import concat

    from pftwin.dynamics.batch.batch_dataset import summed_up

    common = set(parts[0].data_vars).intersection(*(part.data_vars for part in parts))
    whole = concat(
        [part.drop_vars(set(part.data_vars) - common) for part in parts],
        dim="variant",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )
    if not whole.indexes["variant"].is_monotonic_increasing:  # scenes of several structures
        whole = whole.sortby("variant")
    return whole.assign_attrs(summed_up(whole))
