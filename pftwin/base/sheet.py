"""A table of text, which the terminal, Markdown pages and reports render alike."""

from __future__ import annotations

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
    narrow: bool = False  # many columns for a terminal 80 wide

    def table(self) -> Table:
        """For the terminal."""
        from rich import box
        from rich.markup import escape
        from rich.table import Table

        looks: dict[str, Any] = {"box": box.SIMPLE_HEAD, "padding": (0, 1, 0, 0)} if self.narrow else {}
        out = Table(title=escape(self.title), **looks)
        for i, heading in enumerate(self.headings):
            left = self.words is None or i in self.words
            out.add_column(escape(heading), justify="left" if left else "right", no_wrap=self.narrow and not left)
        groups = self.groups or ("",) * len(self.rows)
        for row, group, before in zip(self.rows, groups, (None, *groups), strict=False):
            if before not in (None, group):
                out.add_section()
            out.add_row(*(escape(cell) for cell in row))
        return out

    def grid(self) -> str:
        """The table alone, for pages."""
        rule = ["---" if self.words is None or i in self.words else "---:" for i in range(len(self.headings))]
        rows = [[cell.replace("|", "/") for cell in row] for row in self.rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in (self.headings, rule, *rows))

    def markdown(self) -> str:
        """With title and notes."""
        return "\n".join([f"**{self.title}**", "", self.grid(), "", *(f"- {note}" for note in self.notes)]) + "\n"
