"""Tables of studies: columns with units for CSV and NetCDF."""

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
    """Columns along a dimension, with units and long names; `names`: the column that is its coordinate, if one is."""
    from xarray import Dataset

    from pftwin.results.result_dataset import plain_attribute

    def about(c: Column) -> dict[str, str]:
        return {"units": c.unit, "long_name": c.long_name} if c.unit else {}

    data = {c.key: (dimension, np.array(c.values), about(c)) for c in columns if c.key != names}
    coordinates = {dimension: list(c.values) for c in columns if c.key == names}  # noqa: B035
    return Dataset(data, coords=coordinates, attrs={k: plain_attribute(v) for k, v in attributes.items()})


def short_number(value: float) -> str:
    """Two digits, or whole above a hundred; a dash for what is not known."""
    if not np.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.2g}"
