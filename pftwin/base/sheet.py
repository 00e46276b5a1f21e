"""Tables: text for the terminal, Markdown pages and reports, and columns with units for CSV and NetCDF files."""

from __future__ import annotations

import csv
import io
import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from rich.table import Table
    from xarray import Dataset


class Sheet(NamedTuple):
    """A text table; a line separates the groups of rows."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    groups: tuple[str, ...] = ()  # group of each row
    words: tuple[int, ...] | None = None  # left-aligned columns; None: all
    notes: tuple[str, ...] = ()
    keys: int = 1  # number of leading columns that identify a row

    def tables(self, width: int) -> list[Table]:
        """Renders for a terminal of `width` characters, as several tables if the columns do not fit in one.

        Words and numbers are not broken unless one is too wide to fit beside the first column. Each table starts with
        the key columns or, if several of them leave no room, with the row's number instead.
        """
        texts = zip(self.headings, *self.rows, strict=True)
        columns = [_Width.of(heading, cells, self._left(i)) for i, (heading, *cells) in enumerate(texts)]
        if self.keys > 1 and any(_least([*columns[: self.keys], c]) > width for c in columns[self.keys :]):
            return self._numbered().tables(width)
        return [
            self._table(part, [columns[i] for i in part], width, title=self.title if k == 0 else "")
            for k, part in enumerate(_parts(columns, self.keys, width))
        ]

    def _numbered(self) -> Sheet:
        """The table with a row number as its only key column."""
        rows = tuple((str(i), *row) for i, row in enumerate(self.rows, 1))
        words = None if self.words is None else tuple(i + 1 for i in self.words)
        return self._replace(headings=("row", *self.headings), rows=rows, words=words, keys=1)

    def _left(self, column: int) -> bool:
        return self.words is None or column in self.words

    def _table(self, part: list[int], columns: list[_Width], width: int, title: str) -> Table:
        from rich import box
        from rich.markup import escape
        from rich.table import Table

        framed = sum(c.whole for c in columns) + 3 * len(part) + 1 <= width
        looks: dict[str, Any] = {} if framed else {"box": box.SIMPLE_HEAD, "padding": (0, 1, 0, 0)}
        widths = [c.whole for c in columns] if framed else _widths(columns, width - _frame_width(len(part)))
        out = Table(title=escape(title), **looks)
        for i, column, own in zip(part, columns, widths, strict=True):
            heading = "\n".join(
                textwrap.fill(line, own, break_on_hyphens=False) for line in column.heading.splitlines()
            )
            out.add_column(escape(heading), justify="left" if self._left(i) else "right", width=own, overflow="fold")
        groups = self.groups or ("",) * len(self.rows)
        for row, group, before in zip(self.rows, groups, (None, *groups), strict=False):
            if before not in (None, group):
                out.add_section()
            out.add_row(*(escape(row[i]) for i in part))
        return out

    def grid(self) -> str:
        """Markdown of the table without title and notes."""
        rule = ["---" if self._left(i) else "---:" for i in range(len(self.headings))]
        rows = [[cell.replace("|", "/") for cell in row] for row in self.rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in (self.headings, rule, *rows))

    def markdown(self) -> str:
        """Markdown of the table with title and notes."""
        return "\n".join([f"**{self.title}**", "", self.grid(), "", *(f"- {note}" for note in self.notes)]) + "\n"


class _Width(NamedTuple):
    """Width requirements of a column."""

    heading: str
    least: int  # width without broken words, or numbers separated from their units
    whole: int  # width without additional line breaks

    @staticmethod
    def of(heading: str, cells: list[str], words: bool) -> _Width:
        texts = [line for text in (heading, *cells) for line in text.splitlines()]
        unbroken = [word for text in (heading, *(cells if words else ())) for word in text.split()]
        unbroken += [] if words else [line for cell in cells for line in cell.splitlines()]
        return _Width(heading, *(max(map(_letters, listed), default=1) for listed in (unbroken, texts)))


def _letters(text: str) -> int:
    from rich.cells import cell_len

    return max(cell_len(text), 1)


def _frame_width(columns: int) -> int:
    """Width of edges and spaces in a table without a frame."""
    return 2 * columns + 1


def _least(columns: list[_Width]) -> int:
    """Minimum width of a table with these columns."""
    return sum(c.least for c in columns) + _frame_width(len(columns))


def _parts(columns: list[_Width], keys: int, width: int) -> list[list[int]]:
    """Column indices of tables that fit a width, each with the keys; a column too wide for it gets its own table."""
    first = list(range(keys))
    parts = [first]
    for i in range(keys, len(columns)):
        wanted = [*parts[-1], i]
        if parts[-1] != first and _least([columns[j] for j in wanted]) > width:
            parts.append([*first, i])
        else:
            parts[-1] = wanted
    return parts


def _widths(columns: list[_Width], room: int) -> list[int]:
    """Column widths: the minimum, plus the remaining room for the columns that would be wrapped the most."""
    widths = [c.least for c in columns]
    while sum(widths) > room and max(widths) > 1:
        widths[widths.index(max(widths))] -= 1
    while sum(widths) < room and (most := max(c.whole / w for c, w in zip(columns, widths, strict=True))) > 1:
        widths[next(i for i, c in enumerate(columns) if c.whole / widths[i] == most)] += 1
    return widths


class Column(NamedTuple):
    """One column of a table: numbers or text."""

    key: str  # name in files, including the unit
    values: Sequence[Any]  # numbers (NaN: missing) or text
    unit: str = ""  # empty for text
    long_name: str = ""


def to_csv(columns: Sequence[Column]) -> str:
    """Returns CSV text; numbers have six digits, NaN and None become empty cells."""
    text = io.StringIO()
    sheet = csv.writer(text, lineterminator="\n")
    sheet.writerow([c.key for c in columns])
    sheet.writerows([_cell(v) for v in row] for row in zip(*(c.values for c in columns), strict=True))
    return text.getvalue()


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return "" if value is None else str(value)
    return "" if math.isnan(value) else f"{value:.6g}"


def to_dataset(columns: Sequence[Column], dimension: str, attributes: dict[str, Any], names: str = "") -> Dataset:
    """Returns a dataset of columns along a dimension; `names` is the key of the column to use as its coordinate."""
    import numpy as np
    from xarray import Dataset

    from pftwin.base.quantities import about, netcdf_attribute

    described = {c.key: about(c.unit, c.long_name) if c.unit else {} for c in columns}
    data = {c.key: (dimension, np.array(c.values), described[c.key]) for c in columns if c.key != names}
    coordinates = {dimension: list(c.values) for c in columns if c.key == names}  # noqa: B035
    return Dataset(data, coords=coordinates, attrs={k: netcdf_attribute(v) for k, v in attributes.items()})


def short_number(value: float) -> str:
    """Formats a number with two digits, or as an integer from about a hundred; a dash if it is not finite."""
    if not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.2g}"
