"""A table of text, which the terminal, Markdown pages and reports render alike."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from rich.table import Table


class Sheet(NamedTuple):
    """A table of text; rows of different groups stand apart."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    groups: tuple[str, ...] = ()  # of each row
    words: tuple[int, ...] | None = None  # columns to the left; None: all
    notes: tuple[str, ...] = ()
    keys: int = 1  # number of first columns that say which row it is

    def tables(self, width: int) -> list[Table]:
        """For a terminal of that width: one below the other, where the columns do not fit beside each other.

        No word and no number is broken, unless one is too wide for the terminal beside the first column. Each part
        begins with the key columns; where several of them leave no room, with the number of the row in their place.
        """
        texts = zip(self.headings, *self.rows, strict=True)
        columns = [_Column.of(heading, cells, self._left(i)) for i, (heading, *cells) in enumerate(texts)]
        if self.keys > 1 and any(_least([*columns[: self.keys], c]) > width for c in columns[self.keys :]):
            return self._numbered().tables(width)
        return [
            self._table(part, [columns[i] for i in part], width, title=self.title if k == 0 else "")
            for k, part in enumerate(_parts(columns, self.keys, width))
        ]

    def _numbered(self) -> Sheet:
        """With the row's number as its only key."""
        rows = tuple((str(i), *row) for i, row in enumerate(self.rows, 1))
        words = None if self.words is None else tuple(i + 1 for i in self.words)
        return self._replace(headings=("row", *self.headings), rows=rows, words=words, keys=1)

    def _left(self, column: int) -> bool:
        return self.words is None or column in self.words

    def _table(self, part: list[int], columns: list[_Column], width: int, title: str) -> Table:
        from rich import box
        from rich.markup import escape
        from rich.table import Table

        framed = sum(c.whole for c in columns) + 3 * len(part) + 1 <= width
        looks: dict[str, Any] = {} if framed else {"box": box.SIMPLE_HEAD, "padding": (0, 1, 0, 0)}
        widths = [c.whole for c in columns] if framed else _widths(columns, width - _beside(len(part)))
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
        """The table alone, for pages."""
        rule = ["---" if self._left(i) else "---:" for i in range(len(self.headings))]
        rows = [[cell.replace("|", "/") for cell in row] for row in self.rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in (self.headings, rule, *rows))

    def markdown(self) -> str:
        """With title and notes."""
        return "\n".join([f"**{self.title}**", "", self.grid(), "", *(f"- {note}" for note in self.notes)]) + "\n"


class _Column(NamedTuple):
    """How wide a column has to be."""

    heading: str
    least: int  # without breaking a word, or a number with what stands beside it
    whole: int  # without a further line

    @staticmethod
    def of(heading: str, cells: list[str], words: bool) -> _Column:
        texts = [line for text in (heading, *cells) for line in text.splitlines()]
        unbroken = [word for text in (heading, *(cells if words else ())) for word in text.split()]
        unbroken += [] if words else [line for cell in cells for line in cell.splitlines()]
        return _Column(heading, *(max(map(_letters, listed), default=1) for listed in (unbroken, texts)))


def _letters(text: str) -> int:
    from rich.cells import cell_len

    return max(cell_len(text), 1)


def _beside(columns: int) -> int:
    """What edges and spaces take in a table without a frame."""
    return 2 * columns + 1


def _least(columns: list[_Column]) -> int:
    """The width of a table that has these columns."""
    return sum(c.least for c in columns) + _beside(len(columns))


def _parts(columns: list[_Column], keys: int, width: int) -> list[list[int]]:
    """Columns of tables that fit a width, each with the keys; a column that does not fit beside them comes alone."""
    first = list(range(keys))
    parts = [first]
    for i in range(keys, len(columns)):
        wanted = [*parts[-1], i]
        if parts[-1] != first and _least([columns[j] for j in wanted]) > width:
            parts.append([*first, i])
        else:
            parts[-1] = wanted
    return parts


def _widths(columns: list[_Column], room: int) -> list[int]:
    """The least that columns need, and what is left to those that would else have the longest lines to break."""
    widths = [c.least for c in columns]
    while sum(widths) > room and max(widths) > 1:
        widths[widths.index(max(widths))] -= 1
    while sum(widths) < room and (most := max(c.whole / w for c, w in zip(columns, widths, strict=True))) > 1:
        widths[next(i for i, c in enumerate(columns) if c.whole / widths[i] == most)] += 1
    return widths
