"""Activations of muscles: one number for all, or a file with one over time for each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.mocap.csv_files import read_csv
from pftwin.files.mocap.sto import read_sto
from pftwin.files.mocap.tables import Table

_ROUNDED = 1e-6  # by which optimisers leave the range of an activation


def activations(given: float | str | os.PathLike[str], names: Sequence[str], times: Floats) -> tuple[str, Floats]:
    """Activations (n, muscles) at the times of a motion, and in words where they are from.

    Args:
        given: one of all muscles, 0 to 1; or a STO, MOT or CSV file of activations over time, in columns called like
            the muscles or by their paths ("/forceset/NAME/activation").
        names: of the muscles.
        times: of the motion (n,) [s].

    Raises:
        InputError: no such file, no column of a muscle, times that do not cover the motion, values beyond 0 to 1.
    """
    try:
        number = float(str(given))
    except ValueError:
        return f"from {given}", _recorded(Path(str(given)), names, times)
    if not 0 <= number <= 1:
        raise InputError(
            f"found {number:g}", where="activation", expected="an activation from 0 to 1, or a file of them"
        )
    return f"of {number:g}", np.full((times.size, len(names)), number)


def _recorded(path: Path, names: Sequence[str], times: Floats) -> Floats:
    """Activations at the motion's times, linearly between those of a file."""
    is_csv = path.suffix.lower() == ".csv"
    table = read_csv(path, units="1") if is_csv else read_sto(path, rotational=())
    columns = {_muscle(label): table.column(label) for label in table.names}
    if missing := [name for name in names if name not in columns]:
        raise InputError(
            f"no activation of {', '.join(missing)}",
            where=table.source,
            expected=f"columns called like the muscles, or such as /forceset/{missing[0]}/activation",
        )
    _check_times(table, times)
    found = np.stack([columns[name] for name in names], axis=1)
    low, high = -_ROUNDED, 1 + _ROUNDED
    if (bad := np.argwhere(~((found >= low) & (found <= high)))).size:
        row, k = bad[0]
        where = f"{table.source}, row {row + 1}, {names[k]}"
        raise InputError(f"an activation of {found[row, k]:g}", where=where, expected="0 to 1 in every row")
    return np.stack([np.interp(times, table.times, np.clip(values, 0, 1)) for values in found.T], axis=1)


def _muscle(label: str) -> str:
    return label.removesuffix("/activation").removesuffix(".activation").rpartition("/")[2]


def _check_times(table: Table, times: Floats) -> None:
    slack = 0.5 * float(np.max(np.diff(times))) if times.size > 1 else 0.0
    if table.times[0] > times[0] + slack or table.times[-1] < times[-1] - slack:
        raise InputError(
            f"activations from {table.times[0]:g} s to {table.times[-1]:g} s",
            where=table.source,
            expected=f"for the whole motion, {times[0]:g} s to {times[-1]:g} s",
        )
