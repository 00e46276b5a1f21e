"""`pftwin view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pftwin.base.errors import InputError, OutputError
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json


def view(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULT.nc ...", help="Results of `pftwin simulate`; several are overlaid.")
    ],
    *,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="VIEW.html", help="The page; beside the first result if left out."),
    ] = None,
    names: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="NAME", help="What a result is called in the legend; once for each, in order."),
    ] = None,
    browser: Annotated[bool, typer.Option("--open", help="Show the page in the browser.")] = False,
    json: JsonOption = None,
) -> None:
    """Draw the knee in three dimensions: one HTML file that opens offline, with play and a time slider.

    Example: `pftwin view before.nc after.nc -o view.html`
    """
    page = output or results[0].with_suffix(".html")
    if page.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{page}: the page is HTML; try: {page.with_suffix('.html')}")
    if names and len(names) != len(results):
        raise InputError(f"{len(names)} names for {len(results)} results", where="--name", expected="one for each")
    check_outputs(page, json)
    from pftwin.results.viewer import view as draw

    with working("drawing"):
        draw(list(zip(names, results, strict=True)) if names else results, html=page)
    size = page.stat().st_size
    write_json({"results": [str(p) for p in results], "file": str(page), "bytes": size}, json)
    out(json).print(f"written: {page} ({size / 1e6:.1f} MB)", markup=False, highlight=False)
    if browser:
        typer.launch(page.resolve().as_uri())
