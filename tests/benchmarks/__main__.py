"""`python -m tests.benchmarks`: measures, prints a table, writes JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.base.errors import InputError, PftwinError
from tests.benchmarks.topics import TOPICS

if TYPE_CHECKING:
    from tests.benchmarks.row import Row

app = typer.Typer(add_completion=False)


@app.command()
def main(
    out: Annotated[Path | None, typer.Option(help="Write all figures as JSON to this file.", metavar="FILE")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table for docs/benchmarks.md.")] = False,
    read: Annotated[Path | None, typer.Option(help="Measure nothing: show this JSON.", metavar="FILE")] = None,
    only: Annotated[list[str] | None, typer.Option(help=f"One of: {', '.join(TOPICS)}; may be repeated.")] = None,
    variants: Annotated[int, typer.Option(min=1, help="Size of the batch.")] = 1024,
    quick: Annotated[bool, typer.Option("--quick", help="Small sizes: to try it out, not to quote.")] = False,
) -> None:
    """Speed and accuracy of pftwin on this machine, beside their targets.

    Example: python -m tests.benchmarks --out benchmarks.json --markdown
    """
    try:
        _run(out, read, _chosen(only), markdown, variants, quick)
    except PftwinError as err:
        typer.echo(f"error: {err}", err=True)
        raise typer.Exit(2) from None


def _run(
    out: Path | None, read: Path | None, chosen: tuple[str, ...], markdown: bool, variants: int, quick: bool
) -> None:
    from pftwin.base.output import check_place
    from tests.benchmarks.report import from_json

    if out is not None:
        check_place(out)
    if read is not None:
        rows, machine = from_json(read)
        _keep(out, rows, machine)
    else:
        import pftwin
        from pftwin.base.runtime import describe
        from tests.benchmarks.topics import measure_topics

        pftwin.configure()
        rows, machine = [], describe()
        for measured in measure_topics(chosen, variants, quick, say=lambda text: typer.echo(text, err=True)):
            rows += measured
            _keep(out, rows, machine)  # so that nothing is lost where a later topic is interrupted
    _show(rows, machine, markdown)


def _keep(out: Path | None, rows: list[Row], machine: dict[str, Any]) -> None:
    from pftwin.base.output import written_whole
    from tests.benchmarks.report import to_json

    if out is not None:
        with written_whole(out) as path:
            path.write_text(to_json(rows, machine), encoding="utf-8")


def _chosen(only: list[str] | None) -> tuple[str, ...]:
    for topic in only or ():
        if topic not in TOPICS:
            raise InputError(f"no topic {topic!r}", where="--only", expected=f"one of: {', '.join(TOPICS)}")
    return TOPICS if not only else tuple(t for t in TOPICS if t in only)


def _show(rows: list[Row], machine: dict[str, Any], as_markdown: bool) -> None:
    from rich.console import Console

    from tests.benchmarks import report

    if as_markdown:
        typer.echo(report.markdown(rows, machine))
        return
    console = Console()
    console.print(report.table(rows))
    console.print("[dim]" + ", ".join(f"{k} {v}" for k, v in machine.items() if v != ""))


if __name__ == "__main__":
    app()
