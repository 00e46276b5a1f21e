"""The numbers of a part: one checksum of them, and the quick way to read them from a file."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from xarray import Dataset

MARKS = ("part_key", "part", "part_sha256")  # attributes that a part's file has and a batch has not


def checksum(data: Dataset) -> str:
    """Of all names, shapes and numbers, however a file packs them."""
    total = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        variable = data[name].variable
        values = np.asarray(variable.values)
        total.update(repr((name, variable.dims, values.shape)).encode())
        total.update(_bytes(values))
    return total.hexdigest()


def _bytes(values: np.ndarray[Any, Any]) -> bytes:
    if values.dtype.kind in "OU":
        return json.dumps(values.ravel().tolist()).encode()
    return values.dtype.str.encode() + np.ascontiguousarray(values).tobytes()


def numbers_like(like: Dataset, path: Path) -> Dataset | None:
    """A file's members, as a dataset with the variables, units and attributes of another one.

    xarray takes a fifth of a second to learn what a file holds, ten times what the numbers take. Whether it was right
    to expect the same again, the checksum says: None, or another checksum, and it has to be read in full.

    Raises:
        InputError: a file that is too large, or damaged where `check_netcdf` looks.
    """
    import h5py

    from pftwin.files.netcdf_check import check_netcdf

    check_netcdf(path)
    try:
        with h5py.File(path, "r") as file:
            own = {n: v for n, v in like.variables.items() if v.dims[:1] == ("variant",)}
            read = {n: v.copy(data=_values(file[str(n)], v.dtype)) for n, v in own.items()}
            marks = {name: _plain(file.attrs[name]) for name in MARKS}
    except (KeyError, ValueError, TypeError, OSError, RuntimeError):  # other variables, or a damaged file
        return None
    return _assembled(like, read, marks)


def _assembled(like: Dataset, read: dict[Any, Any], marks: dict[str, Any]) -> Dataset:
    from xarray import Dataset

    whole = {n: read.get(n, v) for n, v in like.variables.items()}
    data = {n: v for n, v in whole.items() if n not in like.coords}
    return Dataset(data, {n: whole[n] for n in like.coords}, {**like.attrs, **marks})


def _values(variable: Any, kind: np.dtype[Any]) -> np.ndarray[Any, Any]:
    if kind.kind == "U":
        return np.array(variable.asstr()[()].tolist(), dtype=str)
    return variable[()].astype(kind, copy=False)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
