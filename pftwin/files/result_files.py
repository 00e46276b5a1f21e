"""Reads and writes results as files: NetCDF, CSV, OpenSim storage. Writing is atomic.

The axes of results are x proximal, y lateral, z anterior, and a left knee is computed as its mirror image. In the axes
of the International Society of Biomechanics, x anterior, y proximal, z to the right, it is a left knee again.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.output import check_place, written_whole
from pftwin.base.text_files import write_text
from pftwin.files.mocap.csv_files import write_csv
from pftwin.files.mocap.tables import Table

if TYPE_CHECKING:
    from xarray import Dataset

_QUATERNION = "component"
GEOMETRY = "geometry"  # the group of a result's file with the geometry to draw
PFTWIN, ISB = "pftwin", "isb"
# Rows: the ISB's axes x, y, z, for a right knee, in the axes of results (Wu et al. 2002, J Biomech 35:543).
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def save_dataset(
    data: Dataset,
    path: str | os.PathLike[str],
    *,
    groups: Mapping[str, Dataset] | None = None,
    encoding: Mapping[str, dict[str, Any]] | None = None,
) -> None:
    """Writes NetCDF-4.

    Args:
        data: the file's root.
        path: target file.
        groups: additional datasets by the name of their group; written compressed.
        encoding: encoding of the root's variables, as in xarray.

    Raises:
        OutputError: the folder is missing, the path is a folder, or the file cannot be written.
    """
    with written_whole(path) as temporary:
        temporary.write_bytes(_netcdf(data, groups or {}, dict(encoding or {})))


def _netcdf(data: Dataset, groups: Mapping[str, Dataset], encoding: dict[str, dict[str, Any]]) -> memoryview:
    """Content of the file, made in memory, since a full disk while HDF5 writes can end the process."""

    import h5netcdf
    from xarray.backends import H5NetCDFStore

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        data.dump_to_store(H5NetCDFStore(file), encoding=encoding)
        for name, group in groups.items():
            packed = {k: {"compression": "gzip", "shuffle": True} for k, v in group.data_vars.items() if v.ndim}
            group.dump_to_store(H5NetCDFStore(file, group=name, mode="a"), encoding=packed)
    return content.getbuffer()


def load_dataset(path: str | os.PathLike[str], *, group: str | None = None) -> Dataset:
    """Reads a dataset written by `save_dataset`, or one of its groups, into memory.

    Raises InputError for no such file or group, not NetCDF-4, too large, and data in other files or missing.
    """
    from xarray import load_dataset as load

    from pftwin.files.netcdf_check import check_netcdf, not_netcdf

    file = Path(path)
    if not file.is_file():
        raise InputError("no such file", where=file, remedy="check the path and the working directory")
    groups = check_netcdf(file)
    if group is not None and group not in groups:
        raise InputError(
            f"holds no group {group!r}",
            where=file,
            expected="a result saved by this version of pftwin",
            remedy="simulate again, e.g. pftwin simulate --case 2 -o case2.nc",
        )
    try:
        return load(file, engine="h5netcdf", group=group)
    except Exception as error:  # the libraries raise whatever their parsing of a damaged file runs into
        raise not_netcdf(file, error) from error


def motion_dataset(result: Any) -> Dataset:
    """Dataset of a `Result` or its file. Raises InputError for no such file, or no result of one simulation."""
    if not isinstance(result, str | os.PathLike):
        return result.to_dataset()
    data = load_dataset(result)
    if "patella_quaternion" not in data:
        raise InputError(
            "no motion of a patella in it",
            where=Path(result),
            expected="a result of one simulation",
            remedy="pftwin simulate --case 2 -o case2.nc",
        )
    return data


def finite_frames(data: Dataset) -> np.ndarray:
    """Indices of the frames at which patella and tibia have a finite pose."""
    names = ("patella_position", "patella_quaternion", "tibia_position", "tibia_quaternion")
    return np.flatnonzero(np.isfinite(np.concatenate([data[n].values for n in names], axis=1)).all(axis=1))


def save_csv(data: Dataset, path: str | os.PathLike[str], axes: str = PFTWIN) -> None:
    """Writes a CSV file with one column per variable and component, units in the header.

    Args:
        data: dataset of a result.
        path: target file.
        axes: "pftwin" or "isb"; a comment (#) at the top names the latter.

    Raises:
        InputError: unknown axes, or ISB axes for a dataset without the side of the knee.
        OutputError: as `save_dataset`.
    """
    columns, units = flat_columns(data)
    columns, notes = _in_axes(columns, data, axes)
    table = Table(data["time"].values, tuple(columns), np.stack([*columns.values()], axis=1), units)
    write_csv(check_place(path), table, notes)


def save_sto(data: Dataset, path: str | os.PathLike[str], axes: str = PFTWIN) -> None:
    """Writes an OpenSim storage file (.sto): angles in degrees, as its header states, all else in SI units.

    `axes` and errors: as in `save_csv`; the header names ISB axes.
    """
    title = str(data.attrs.get("title", "pftwin result")).replace("\n", " ")
    columns, notes = _in_axes(flat_columns(data)[0], data, axes)
    write_storage(path, title, data["time"].values, columns, [*reservations(data), *notes])


def _in_axes(columns: dict[str, np.ndarray], data: Dataset, axes: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns in the requested axes, and lines about them for the header of a file."""
    if check_axes(axes) == PFTWIN:
        return columns, []
    side = data.attrs.get("side")
    if side is None:
        raise InputError(
            "does not tell a left knee from a right one",
            where=data.attrs.get("scene"),
            expected="a result saved by this version of pftwin",
            remedy="simulate again, or the axes of pftwin",
        )
    said = f"Axes: ISB (Wu et al. 2002), {side} knee: x anterior, y proximal, z to the right"
    return in_isb_axes(columns, side == "left"), [said]


def reservations(data: Dataset) -> list[str]:
    """Lines with the verdict and notes on a result, for the header of a format without attributes."""
    return [f"{name.title()}: {data.attrs[name]}" for name in ("verdict", "note") if data.attrs.get(name)]


def write_storage(
    path: str | os.PathLike[str],
    title: str,
    times: np.ndarray,
    columns: Mapping[str, np.ndarray],
    notes: Iterable[str] = (),
) -> None:
    """Writes columns (n,) in OpenSim's storage format, angles in degrees; `notes` are lines of the header.

    Raises OutputError as `save_dataset`.
    """
    counts = f"nRows={times.size}", f"nColumns={len(columns) + 1}"
    head = [title, "version=1", *counts, "inDegrees=yes", *notes, "endheader", "\t".join(["time", *columns])]
    rows = np.column_stack([times, *columns.values()])
    lines = ["\t".join(f"{x:.12g}" for x in row) for row in rows]
    write_text(check_place(path), "\n".join([*head, *lines]) + "\n")


def flat_columns(data: Dataset) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns (n,) and their units by name; suffixes are _x, _y, _z, of quaternions _qw ... _qz, else _1, _2 ..."""
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for name, variable in data.data_vars.items():
        prefix = str(name).removesuffix("_quaternion") if _QUATERNION in variable.dims else str(name)
        labels = [""]
        for dimension in variable.dims[1:]:
            if dimension in data.coords:
                prefix_of_part = "_q" if dimension == _QUATERNION else "_"
                parts = [f"{prefix_of_part}{value}" for value in data[dimension].values]
            else:
                parts = [f"_{i + 1}" for i in range(variable.sizes[dimension])]
            labels = [a + b for a in labels for b in parts]
        values = np.asarray(variable.values, dtype=np.float64).reshape(variable.sizes["time"], -1)
        for label, column in zip(labels, values.T, strict=True):
            columns[prefix + label] = column
            units[prefix + label] = "" if label.startswith("_q") else str(variable.attrs.get("units", "1"))
    return columns, units


def check_axes(axes: str) -> str:
    """Returns the name of the axes; InputError if it is unknown."""
    if axes not in (PFTWIN, ISB):
        raise InputError(f"found {axes!r}", where="axes", expected=f"{PFTWIN} or {ISB}")
    return axes


def in_isb_axes(columns: Mapping[str, Floats], left: bool) -> dict[str, Floats]:
    """Columns (n,) with all vectors (NAME_x, NAME_y, NAME_z) and rotations (NAME_qx, NAME_qy, NAME_qz) in ISB axes.

    Vectors are positions and forces. The axis of a rotation turns the other way in a mirror image. All other columns,
    such as lengths and clinical angles, are the same in any axes.
    """
    turn = np.diag([1.0, 1.0, -1.0 if left else 1.0]) @ AXES
    turned = dict(columns)
    for start, matrix in (("_", turn), ("_q", np.linalg.det(turn) * turn)):
        for name in (n.removesuffix(f"{start}x") for n in columns if n.endswith(f"{start}x")):
            parts = [f"{name}{start}{axis}" for axis in "xyz"]
            if all(part in columns for part in parts):
                turned |= zip(parts, matrix @ np.stack([columns[part] for part in parts]), strict=True)
    return turned
