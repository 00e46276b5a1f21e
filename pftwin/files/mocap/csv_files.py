"""Reads and writes tables and markers as CSV files with a header line."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.text_files import csv_cells, read_lines, refuse_repeated, shortened_list, write_text
from pftwin.files.mocap.markers import MarkerTrajectories, from_file
from pftwin.files.mocap.tables import Table, row_values, unknown_name
from pftwin.files.mocap.units import length_factor, split_unit, to_si

_COORDINATE = re.compile(r"^(?P<marker>.+?)[_ .:]?(?P<axis>[xyzXYZ])$")
Units = Mapping[str, str] | str | None


def read_csv(path: str | os.PathLike[str], *, time_column: str | None = None, units: Units = None) -> Table:
    """Reads a numeric table with one header line and converts it to SI units.

    Units come from the header ("quadriceps_N", "Fz (kN)", "angle [deg]") or from the argument; columns are named
    without their unit. Quaternion components (..._qw), "frame" and "status" are dimensionless.
    Lines that begin with # are comments. The delimiter is a comma, a semicolon or a tab. Empty cells are NaN.

    Args:
        path: the file.
        time_column: header of the column of times; by default the one called time or t.
        units: {column: unit} with names as in the header, with or without unit; or one unit for all columns without a
            unit in the header ("1": dimensionless).

    Raises:
        InputError: missing, empty, truncated, binary or non-numeric content (naming file, line and column); a column
            without unit; unknown or contradictory units; repeated names; no time column; repeated or unsorted times.
    """
    labels, values = _read_columns(path)
    at = _time_index(labels, time_column, path)
    parts = [split_unit(label) for label in labels]
    if isinstance(units, str):  # for columns without a unit, but not for the time
        given = {label: units for i, label in enumerate(labels) if parts[i][1] is None and i != at}
    else:
        given = dict(units or {})
    known = {*labels, *(name for name, _ in parts)}
    if strange := [key for key in given if key not in known]:
        raise unknown_name("column", strange[0], labels, where=f"{path}, argument units")
    found = [
        _unit(
            label,
            unit,
            given.get(label, given.get(name)),
            path,
            remedy="the header time_s (or time_ms)" if i == at else "",
        )
        for i, (label, (name, unit)) in enumerate(zip(labels, parts, strict=True))
    ]
    _check_time(found[at][0], labels[at], path)
    values = values * [factor for _, factor in found]
    columns = [i for i in range(len(labels)) if i != at]
    si_units = {parts[i][0]: found[i][0] for i in columns}
    return Table(values[:, at], tuple(parts[i][0] for i in columns), values[:, columns], si_units, source=str(path))


def read_marker_csv(
    path: str | os.PathLike[str],
    *,
    time_column: str | None = None,
    units: str | None = None,
    time_unit: str | None = None,
) -> MarkerTrajectories:
    """Reads markers from a table with the columns NAME_x, NAME_y, NAME_z, with or without a unit ("NAME_x_mm").

    Missing markers are empty cells, NaN or three exact zeros. Other columns except the time and "frame" are errors.

    Args:
        path: the file.
        time_column: header of the column of times (s or ms); by default the one called time or t.
        units: unit of length if the header has none.
        time_unit: unit of the times ("s", "ms") if the header has none.

    Raises:
        InputError: as `read_csv`; a marker with missing or repeated coordinates ("A_x" and "Ax");
            an implausible unit.
    """
    labels, values = _read_columns(path)
    at = _time_index(labels, time_column, path)
    unit, time_factor = _unit(labels[at], split_unit(labels[at])[1], time_unit, path, remedy="time_unit='s' (or 'ms')")
    _check_time(unit, labels[at], path)
    found: dict[str, dict[str, np.ndarray]] = {}
    for i, label in enumerate(labels):
        if i == at or label.strip("#").lower() == "frame":
            continue
        name, header_unit = split_unit(label)
        match = _COORDINATE.match(name)
        if not match:
            raise InputError(f"column {label!r} is no coordinate", where=path, expected="NAME_x, NAME_y, NAME_z")
        factor = length_factor(header_unit, None if header_unit else units, where=f"{path}, column {label!r}")
        axes, axis = found.setdefault(match["marker"], {}), match["axis"].lower()
        if axis in axes:
            raise InputError(
                f"column {label!r} is marker {match['marker']!r}'s second {axis}", where=path, expected="each once"
            )
        axes[axis] = values[:, i] * factor
    incomplete = [name for name, axes in found.items() if len(axes) != 3]
    if incomplete or not found:
        problem = f"markers without all three coordinates: {shortened_list(incomplete)}" if incomplete else "no markers"
        raise InputError(problem, where=path, expected="NAME_x, NAME_y, NAME_z for every marker")
    positions = np.stack([np.stack([a[k] for k in "xyz"], -1) for a in found.values()], axis=1)
    return from_file(values[:, at] * time_factor, tuple(found), positions, path=path, unit_given=units is not None)


def write_csv(path: str | os.PathLike[str], data: Table | MarkerTrajectories, notes: Iterable[str] = ()) -> None:
    """Writes a table or markers as CSV with units in the header; missing values are empty cells.

    `notes` are lines at the top, as comments (#).

    Raises:
        OutputError: the file cannot be written.
    """
    if isinstance(data, MarkerTrajectories):
        labels = [f"{name}_{axis}_m" for name in data.names for axis in "xyz"]
        values = data.positions.reshape(data.times.size, -1)
    else:
        labels = [f"{name} [{data.units[name]}]" if data.units[name] else name for name in data.names]
        values = data.values
    lines = [*(f"# {note}" for note in notes), ",".join(_quote(label) for label in ["time_s", *labels])]
    for t, row in zip(data.times, values, strict=True):
        lines.append(f"{t:.9f}," + ",".join("" if v != v else f"{v:.12g}" for v in row))
    write_text(path, "\n".join(lines) + "\n")


def _quote(label: str) -> str:
    return '"' + label.replace('"', '""') + '"' if set(label) & set(',"\n') else label


def _read_columns(path: str | os.PathLike[str]) -> tuple[list[str], np.ndarray]:
    """Labels (k) and values (n, k) as in the file, without conversion."""
    lines, ended = read_lines(path)
    used = [(i, line) for i, line in enumerate(lines, start=1) if line.strip() and not line.lstrip().startswith("#")]
    if not used:
        raise InputError("no header line", where=path, expected="a line of column names")
    first, header = used[0]
    delimiter = max(",;\t", key=header.count)
    labels = [c.strip() for c in csv_cells(header, path=path, number=first, delimiter=delimiter)]
    while labels and not labels[-1]:
        labels.pop()
    if not all(labels):
        raise InputError(f"column {labels.index('') + 1} has no name", where=f"{path}, line {first}")
    refuse_repeated(labels, "columns", where=f"{path}, line {first}")
    rows = []
    for line_number, line in used[1:]:
        cells = csv_cells(line, path=path, number=line_number, delimiter=delimiter)
        while len(cells) > len(labels) and not cells[-1].strip():
            cells.pop()
        rows.append((line_number, cells))
    return labels, row_values(rows, labels, ended=ended, path=path)


def _time_index(labels: list[str], time_column: str | None, path: object) -> int:
    if time_column is not None:
        wanted = [i for i, label in enumerate(labels) if time_column in (label, split_unit(label)[0])]
        if not wanted:
            raise unknown_name("column", time_column, labels, where=f"{path}, argument time_column")
        return wanted[0]
    found = [i for i, label in enumerate(labels) if split_unit(label)[0].lower() in {"time", "t"}]
    if len(found) > 1:
        shown = shortened_list(repr(labels[i]) for i in found)
        raise InputError(f"several columns of times: {shown}", where=path, expected="one, or its name as time_column")
    if found:
        return found[0]
    expected = "a column time_s or time [s]"
    raise InputError("no column of times", where=path, expected=expected, remedy="its name as argument time_column")


def _check_time(unit: str, label: str, path: object) -> None:
    if unit != "s":
        raise InputError(f"the unit of the times is {unit}", where=f"{path}, column {label!r}", expected="s or ms")


def _unit(label: str, header: str | None, given: str | None, path: object, *, remedy: str = "") -> tuple[str, float]:
    where = f"{path}, column {label!r}"
    if header is None and given is None:
        raise InputError(
            "no unit in the header, and none given",
            where=where,
            expected="a header like 'force_N' or 'time [s]'",
            remedy=remedy or f"units={{{label!r}: 'N'}} (whatever is true; '1' if it has no dimension)",
        )
    if header is not None and given is not None and to_si(header, where=where) != to_si(given, where=where):
        raise InputError(
            f"the header says {header!r}, the argument units says {given!r}", where=where, expected="one of them"
        )
    return to_si(header if header is not None else given or "1", where=where)
