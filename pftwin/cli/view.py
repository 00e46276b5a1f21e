"""`pftwin view`: the knee in 3D, as a page or a film."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from pftwin.base.errors import InputError
from pftwin.cli import terminal
from pftwin.cli.exit_codes import exit_flagged


def view(
    results: Annotated[list[Path], Argument(metavar="RESULT.nc ...", help="Results of `pftwin simulate`.")],
    *,
    output: Annotated[
        Path | None,
        Option("-o", "--output", metavar="VIEW.html", help="The page; by default next to the first result."),
    ] = None,
    names: Annotated[
        list[str] | None,
        Option("--name", metavar="NAME", help="Name of a result in the legend; once for each, in order."),
    ] = None,
    side_by_side: Annotated[
        bool, Option("--side-by-side", help="Show several results next to each other instead of overlaid.")
    ] = False,
    record: Annotated[
        Path | None,
        Option("--record", metavar="FILM.(gif|mp4)", help="Write a film; no page unless -o is given."),
    ] = None,
    camera: Annotated[
        Literal["anterior", "lateral", "medial", "skyline"], Option("--camera", help="Camera of the film.")
    ] = "anterior",
    speed: Annotated[float, Option("--speed", metavar="FACTOR", help="Playback speed of the film.")] = 1.0,
    see_through: Annotated[
        bool, Option("--see-through", help="Make the patella transparent in the film, to show the contact behind it.")
    ] = False,
    browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
    json: terminal.JsonOption = None,
) -> None:
    """Draw the knee in 3D: a single HTML file that opens offline, with play and a time slider, or a film.

    Example: `pftwin view before.nc after.nc -o view.html`
    """
    page = output or (results[0].with_suffix(".html") if record is None or browser else None)
    if page is not None:
        terminal.check_suffix(page, [".html", ".htm"], "the page is HTML")
    if record is not None:
        terminal.check_suffix(record, [".gif", ".mp4"], "the suffix chooses the film's format")
    if names and len(names) != len(results):
        raise InputError(f"{len(names)} names for {len(results)} results", where="--name", expected="one for each")
    terminal.check_outputs(page, record, json)
    from pftwin.files.result_files import load_dataset
    from pftwin.results.verdict import verdict_of_file
    from pftwin.results.viewer import view as draw
    from pftwin.results.viewer.film import check_film, write_film

    if record is not None:
        check_film(record, speed)
        if side_by_side and len(results) > 1 and camera in ("lateral", "medial"):
            found = f"{camera} with --side-by-side: from the side one knee hides the others"
            raise InputError(found, where="--camera", expected="anterior or skyline")
    named = list(zip(names, results, strict=True)) if names else results
    with terminal.spinner("drawing"):
        plot = draw(named, html=page, side_by_side=side_by_side)
    if record is not None:
        with terminal.progress("filming") as show:
            write_film(plot, record, camera=camera, speed=speed, see_through=see_through, progress=show)
    sizes = [(str(path), path.stat().st_size) for path in (page, record) if path is not None]
    facts = {"results": [str(p) for p in results], "files": [{"file": p, "bytes": size} for p, size in sizes]}
    terminal.present(facts, *(f"written: {path} ({size / 1e6:.1f} MB)" for path, size in sizes), json=json)
    if browser and page is not None:
        typer.launch(page.resolve().as_uri())
    verdicts = {path.name: verdict_of_file(load_dataset(path)) for path in results}
    if doubts := [f"{v.describe()} ({name})" for name, v in verdicts.items() if not v.valid]:
        exit_flagged("; ".join(doubts))
