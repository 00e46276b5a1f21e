"""The measured part of docs/fitting_benchmarks.md, and the files beside it, from rows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from tests.benchmarks import report
from tests.benchmarks.row import Row

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
FIGURE = "methods"


def check_page(page: Path) -> str:
    """The page's text.

    Raises:
        InputError: no such page, or no place for figures in it.
    """
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as err:
        raise InputError(
            f"cannot be read: {err.strerror}", where=str(page), remedy="docs/fitting_benchmarks.md"
        ) from err
    if not 0 <= text.find(BEGIN) < text.find(END):
        raise InputError("no place for figures", where=str(page), expected=f"the lines {BEGIN} and {END}")
    return text


def write_page(page: Path, rows: Sequence[Row], machine: dict[str, Any]) -> list[Path]:
    """Puts tables into a page, and beside it in the folder of its name the comparison's figure and table.

    Args:
        page: a Markdown file with the two lines between which everything is replaced.
        rows: of the benchmark.
        machine: that they were measured on.

    Raises:
        InputError: see `check_page`.
        OutputError: a file cannot be written.
    """
    from tests.benchmarks.fitting.methods.table import comma_list, courses_of, markdown, targets

    text = check_page(page)
    folder, written = page.with_suffix(""), [page]
    measured = [report.markdown(targets(rows), machine)]
    courses = courses_of(rows)
    if courses:
        from pftwin.results.plots import save_figure
        from tests.benchmarks.fitting.methods.figure import comparison_figure

        budget = next(r.details["budget"] for r in rows if "courses" in r.details)
        folder.mkdir(exist_ok=True)
        written += save_figure(comparison_figure(courses, (budget[0], budget[1])), folder / FIGURE)
        table = folder / f"{FIGURE}.csv"
        with written_whole(table) as path:
            path.write_text(comma_list(rows), encoding="utf-8")
        written.append(table)
        caption = (
            f"### Methods\nMedian (range) over seeds; equal evaluations: {budget[0]:,}; equal time: {budget[1]:g} s of "
            "processor time. SYNTHETIC measurements.\n"
        )
        picture = f"![Best objective so far of every method]({folder.name}/{FIGURE}.png)\n"
        measured += [caption, markdown(rows), picture]
    before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
    with written_whole(page) as path:
        path.write_text(before + "\n" + "\n".join(measured) + after, encoding="utf-8")
    return written
