"""`python -m tests.benchmarks.fitting`: measures, prints a table, writes JSON and the page of the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.base.errors import InputError, PftwinError
from tests.benchmarks.fitting.topics import TOPICS

if TYPE_CHECKING:
    from tests.benchmarks.row import Row

app = typer.Typer(add_completion=False)


@app.command()
def main(
    topics: Annotated[
        str | None, typer.Option(help=f"Some of: {', '.join(TOPICS)}; with commas.", metavar="TOPICS")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write all figures as JSON to this file.", metavar="FILE")] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Of efficiency and methods; by default 25 and 10.", show_default=False)
    ] = None,
    page: Annotated[
        Path | None, typer.Option(help="Put tables and figure into this page (docs/fitting_benchmarks.md).")
    ] = None,
    read: Annotated[Path | None, typer.Option(help="Measure nothing: show this JSON.", metavar="FILE")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small sizes: to try it out, not to quote.")] = False,
) -> None:
    """Speed and accuracy of fits and predictions on this machine, beside their targets.

    Example: python -m tests.benchmarks.fitting --topics speed,methods --out fitting.json
    """
    try:
        _run(chosen(topics), out, seeds, page, read, quick)
    except PftwinError as err:
        typer.echo(f"error: {err}", err=True)
        raise typer.Exit(2) from None


def _run(
    topics: tuple[str, ...], out: Path | None, seeds: int | None, page: Path | None, read: Path | None, quick: bool
) -> None:
    from pftwin.base.output import check_place, written_whole
    from tests.benchmarks.fitting.page import check_page, write_page
    from tests.benchmarks.report import from_json, to_json

    if out is not None:
        check_place(out)
    if page is not None:
        check_page(page)
    if read is not None:
        rows, machine = from_json(read)
        rows = [r for r in rows if r.topic in topics]
    else:
        from tests.benchmarks.fitting.topics import measure_topics

        rows, machine = measure_topics(topics, seeds, quick, say=lambda text: typer.echo(text, err=True))
    if out is not None:
        with written_whole(out) as path:
            path.write_text(to_json(rows, machine), encoding="utf-8")
    if page is not None:
        for path in write_page(page, rows, machine):
            typer.echo(f"wrote {path}", err=True)
    _show(rows, machine)


def chosen(topics: str | None) -> tuple[str, ...]:
    """The topics that were named, in the order in which they are measured.

    Raises:
        InputError: no such topic.
    """
    if topics is None:
        return TOPICS
    named = [t.strip() for t in topics.split(",")]
    for topic in named:
        if topic not in TOPICS:
            raise InputError(f"no topic {topic!r}", where="--topics", expected=f"some of: {', '.join(TOPICS)}")
    return tuple(t for t in TOPICS if t in named)


def _show(rows: list[Row], machine: dict[str, Any]) -> None:
    from rich.console import Console

    from tests.benchmarks import report
    from tests.benchmarks.fitting.methods.table import markdown, targets

    console = Console()
    console.print(report.table(targets(rows), "pftwin: benchmarks of fitting"))
    if compared := markdown(rows):
        typer.echo(compared)
    console.print("[dim]" + ", ".join(f"{k} {v}" for k, v in machine.items() if v != ""))


if __name__ == "__main__":
    app()
