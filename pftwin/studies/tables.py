"""Tables of studies: columns with units, written as CSV or NetCDF."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from xarray import Dataset


class Column(NamedTuple):
    """One column of a table: numbers or text."""

    key: str  # name in files, including the unit
    values: Sequence[Any]  # numbers (NaN: missing) or text
    unit: str = ""  # empty for text
    long_name: str = ""


def to_csv(columns: Sequence[Column]) -> str:
    """Returns CSV text with units in the column names; NaN becomes an empty cell."""
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
    """Returns a dataset of columns along a dimension; `names` is the key of the column to use as its coordinate."""
    from xarray import Dataset

    from pftwin.results.result_dataset import plain_attribute

    def about(c: Column) -> dict[str, str]:
        return {"units": c.unit, "long_name": c.long_name} if c.unit else {}

    data = {c.key: (dimension, np.array(c.values), about(c)) for c in columns if c.key != names}
    coordinates = {dimension: list(c.values) for c in columns if c.key == names}  # noqa: B035
    return Dataset(data, coords=coordinates, attrs={k: plain_attribute(v) for k, v in attributes.items()})


def short_number(value: float) -> str:
    """Formats a number with two digits, or as an integer from about a hundred; a dash if it is not finite."""
    if not np.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.2g}"
