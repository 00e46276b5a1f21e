"""Tables of studies: columns with units for CSV and NetCDF, and rows read back."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.text_files import read_json, read_lines

if TYPE_CHECKING:
    from xarray import Dataset

R = TypeVar("R")


class Column(NamedTuple):
    """A figure, or words, of every row."""

    key: str  # with its unit, as files have it
    values: Sequence[Any]  # numbers (NaN: none) or words
    unit: str = ""  # none: words
    long_name: str = ""


def to_csv(columns: Sequence[Column]) -> str:
    """Comma-separated, units in the names; empty where there is no number."""
    text = io.StringIO()
    sheet = csv.writer(text, lineterminator="\n")
    sheet.writerow([c.key for c in columns])
    sheet.writerows([_cell(v) for v in row] for row in zip(*(c.values for c in columns), strict=True))
    return text.getvalue()


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return "" if math.isnan(value) else f"{value:.6g}"


def to_dataset(columns: Sequence[Column], dimension: str, attributes: dict[str, Any], names: str = "") -> Dataset:
    """Units and long names on every variable.

    Args:
        columns: words have no unit.
        dimension: of the rows.
        attributes: of the whole.
        names: the column that is the dimension's coordinate, if one is.
    """
    from xarray import Dataset

    from pftwin.results.result_dataset import plain_attribute

    def about(c: Column) -> dict[str, str]:
        return {"units": c.unit, "long_name": c.long_name} if c.unit else {}

    data = {c.key: (dimension, np.array(c.values), about(c)) for c in columns if c.key != names}
    coordinates = {dimension: list(c.values) for c in columns if c.key == names}  # noqa: B035
    return Dataset(data, coords=coordinates, attrs={k: plain_attribute(v) for k, v in attributes.items()})


def read_csv(path: str | os.PathLike[str], row: type[R], needed: Sequence[str], expected: str) -> list[R]:
    """Rows that `to_csv` wrote, by this version or by one that knew fewer columns: a number that is lacking is NaN.

    Lines that start with # and columns that a row does not have are passed over.

    Args:
        path: of the file.
        row: class of rows whose fields are words and numbers.
        needed: columns without which a row says nothing.
        expected: what kind of file it is to be, for messages.

    Raises:
        InputError: no such file, or one without the columns that make a row.
    """
    lines = read_lines(path)[0]
    kinds = {n: kind for n, kind in get_type_hints(row).items() if kind in (str, int, float)}
    found = []
    for number, cells in enumerate(csv.DictReader(x for x in lines if not x.startswith("#")), start=1):
        if missing := [n for n in needed if cells.get(n) is None or (kinds[n] is str and not cells[n])]:
            raise InputError(f"row {number} has no {missing[0]}", where=path, expected=expected)
        try:
            values = {n: kind(cells.get(n) or ("" if kind is str else "nan")) for n, kind in kinds.items()}
        except ValueError as error:
            raise InputError(f"row {number}: {error}", where=path, expected="numbers") from error
        found.append(row(**values))
    return found


def read_rows(path: str | os.PathLike[str], row: Callable[..., R], expected: str) -> tuple[dict[str, Any], list[R]]:
    """What a study has written as JSON, and its "rows".

    Args:
        path: of the file.
        row: class of rows, by the names of its fields.
        expected: what kind of file it is to be, for messages.

    Raises:
        InputError: no such file, no JSON, or no such rows.
    """
    found = read_json(path, expected=expected)
    try:
        return found, [row(**one) for one in found["rows"]]
    except (KeyError, TypeError) as error:
        raise InputError(f"no such rows in it: {error}", where=path, expected=expected) from error


def short_number(value: float) -> str:
    """Two digits, or whole above a hundred; a dash for what is not known."""
    if not np.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.2g}"
