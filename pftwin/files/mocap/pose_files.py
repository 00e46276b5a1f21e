"""Reads poses of bodies: tables of positions and quaternions, or of 4 x 4 matrices as OpenSim JAM writes them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinWarning
from pftwin.files.mocap.csv_files import read_csv
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.mocap.sto import read_sto
from pftwin.files.mocap.tables import Table, unknown_name

_PARTS = ("px", "py", "pz", "qw", "qx", "qy", "qz")
_ENTRIES = tuple(f"T{row}{column}" for row in range(1, 5) for column in range(1, 5))
_FIRST = f"_{_ENTRIES[0]}"
_MATRICES = (".sto", ".mot")  # suffixes of files of matrices
_RIGID = 1e-3  # tolerance for the entries of R^T R - 1: rounding
_FARTHEST = 10.0  # largest plausible distance from the laboratory's origin [m]


def read_poses(
    path: str | os.PathLike[str], bodies: Sequence[str] | None = None, *, rate: float | None = None
) -> dict[str, PoseSeries]:
    """Reads poses of bodies, in the file's reference frame.

    A table (.csv) has the columns time_s and BODY_px_m, _py_m, _pz_m, BODY_qw, _qx, _qy, _qz of each body; other units
    of length and time are converted. A file of matrices (.sto, .mot) has time and BODY_T11, BODY_T12 ... BODY_T44:
    the body's axes in columns 1 to 3, and its origin in column 4, in metres.

    Args:
        path: the file.
        bodies: names of the bodies to read; by default all.
        rate: frames per second, if `time` in a file of matrices is a frame number.

    Raises:
        InputError: as `read_csv` and `read_sto`; an unknown body (with the closest known names) or an incomplete one;
            rows without a pose; quaternions that are not unit; matrices that are singular, mirrored or transposed;
            positions that are not in metres; rows that repeat the one before; frame numbers as times without a rate,
            or a rate for times in seconds.
    """
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise InputError(f"found {rate!r}", where="rate", expected="frames per second, a positive number")
    if Path(path).suffix.lower() in _MATRICES:
        return _of_matrices(path, bodies, rate)
    if rate is not None:
        raise InputError("a rate beside times in seconds", where=path, expected="one of both", remedy="no rate")
    table = read_csv(path, units="1")  # other columns (an angle, a flag) are ignored
    found = {}
    for body in _wanted(table, "_qw", bodies, "columns BODY_px_m ... BODY_qz", path):
        columns = _columns(table, body, _PARTS, path)
        if off := [c for c in columns[:3] if table.units[c] != "m"]:
            raise InputError(f"column {off[0]!r} has no unit of length", where=path, expected=f"{off[0]}_m")
        values = table.select(columns).values
        found[body] = PoseSeries(table.times, values[:, :3], values[:, 3:], source=f"{path}, body {body!r}")
    return found


def holds_matrices(path: str | os.PathLike[str]) -> bool:
    """Whether an STO file contains poses as matrices, not coordinates. Raises InputError as `read_sto`."""
    if Path(path).suffix.lower() not in _MATRICES:
        return False
    with warnings.catch_warnings(action="ignore", category=PftwinWarning):  # the later reading warns
        return any(name.endswith(_FIRST) for name in read_sto(path, rotational=()).names)


def _wanted(
    table: Table, ending: str, bodies: Sequence[str] | None, expected: str, path: str | os.PathLike[str]
) -> Sequence[str]:
    """Names of the bodies to read; raises InputError if one is missing."""
    found = [name.removesuffix(ending) for name in table.names if name.endswith(ending)]
    if not found:
        raise InputError("no poses", where=path, expected=expected)
    for body in bodies or ():
        if body not in found:
            raise unknown_name("body", body, found, where=path)
    return found if bodies is None else bodies


def _columns(table: Table, body: str, parts: Sequence[str], path: str | os.PathLike[str]) -> list[str]:
    columns = [f"{body}_{part}" for part in parts]
    if missing := [c for c in columns if c not in table.names]:
        raise InputError(f"body {body!r} has no column {missing[0]!r}", where=path, expected=", ".join(columns))
    return columns


def _of_matrices(
    path: str | os.PathLike[str], bodies: Sequence[str] | None, rate: float | None
) -> dict[str, PoseSeries]:
    table = read_sto(path, rotational=())
    names = _wanted(table, _FIRST, bodies, f"columns BODY_{_ENTRIES[0]} ... BODY_{_ENTRIES[-1]}", path)
    columns = {body: _columns(table, body, _ENTRIES, path) for body in names}
    times = _seconds(table.times, rate, path)
    found = {}
    for body, own in columns.items():
        source = f"{path}, body {body!r}"
        matrices = table.select(own).values.reshape(-1, 4, 4)
        _check_rigid(matrices, source)
        found[body] = PoseSeries.from_matrices(times, matrices[:, :3, 3], matrices[:, :3, :3], source=source)
    _check_repeated(table.values[:, [name.rpartition("_")[2] in _ENTRIES for name in table.names]], path)
    return found


def _seconds(times: Floats, rate: float | None, path: str | os.PathLike[str]) -> Floats:
    """Times [s], converted from frame numbers if necessary."""
    numbered = times.size > 1 and bool(np.all(times == np.round(times)))
    if rate is None and numbered:
        found = f"time counts frames, {times[0]:g} to {times[-1]:g}"
        remedy = "state the rate: rate_Hz in [motion], --rate, or rate=; 1 where they are seconds"
        raise InputError(found, where=path, expected="seconds", remedy=remedy)
    if rate is not None and not numbered:
        found = f"a rate of {rate:g} Hz, and times from {times[0]:g} to {times[-1]:g} that are no frames' numbers"
        raise InputError(found, where=path, expected="a rate or times in seconds", remedy="no rate")
    return times if rate is None else times / rate


def _check_rigid(matrices: Floats, source: str) -> None:
    """Checks that all matrices are poses; the error names the first wrong row (from 1)."""
    expected = "rotations with a place in metres: axes of length one at right angles, last row 0 0 0 1"

    def refuse(wrong: ArrayLike, what: str, remedy: str | None = None) -> None:
        if np.any(wrong):
            row = int(np.argmax(wrong))
            raise InputError(f"row {row + 1}: {what}", where=source, expected=expected, remedy=remedy)

    refuse(~np.isfinite(matrices).all(axis=(1, 2)), "a matrix with missing numbers")
    bottom = np.abs(matrices[:, 3] - [0, 0, 0, 1]).max(axis=1) > _RIGID
    transposed = bottom & (np.abs(matrices[:, :, 3] - [0, 0, 0, 1]).max(axis=1) <= _RIGID)
    refuse(transposed, "a transposed matrix, with the position in the last row", "exchange rows and columns")
    refuse(bottom, "a matrix whose last row is not 0 0 0 1")
    turns = matrices[:, :3, :3]
    skewed = np.abs(np.swapaxes(turns, 1, 2) @ turns - np.eye(3)).max(axis=(1, 2)) > _RIGID
    volume = np.linalg.det(turns)
    refuse(np.abs(volume) < _RIGID, "a singular matrix")
    refuse(skewed, "a matrix whose axes are not of length one at right angles")
    refuse(volume < 0, "a mirrored matrix (determinant -1)", "right-handed axes for every body")
    far = np.linalg.norm(matrices[:, :3, 3], axis=1) > _FARTHEST
    refuse(far, "more than 10 m from the origin: in millimetres?", "places in metres")


def _check_repeated(rows: Floats, path: str | os.PathLike[str]) -> None:
    """Checks that no frame repeats the one before exactly, unless nothing moves at all."""
    same = (np.diff(rows, axis=0) == 0).all(axis=1)
    if same.any() and not same.all():
        row = int(np.argmax(same)) + 1
        found = f"row {row + 1} repeats row {row} to the last digit: a frame that was held or copied"
        raise InputError(found, where=path, expected="each frame once", remedy="leave such rows out, times with them")
