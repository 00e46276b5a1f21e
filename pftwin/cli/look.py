"""`pftwin view`, `pftwin explain` and `pftwin audit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from pftwin.base.errors import InputError
from pftwin.base.runtime import describe
from pftwin.base.written_amounts import amount
from pftwin.cli import terminal
from pftwin.cli.exit_codes import Interrupted, check_trust_of_files, exit_flagged, report_written_on_interrupt
from pftwin.cli.scenes import RunOptions, on_scene

if TYPE_CHECKING:
    from pftwin.studies.audit.audit import Audit


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
        with terminal.progress("filming") as shown:
            write_film(plot, record, camera=camera, speed=speed, see_through=see_through, progress=shown)
    sizes = [(str(path), path.stat().st_size) for path in (page, record) if path is not None]
    facts = {"results": [str(p) for p in results], "files": [{"file": p, "bytes": size} for p, size in sizes]}
    terminal.present(facts, *(f"written: {path} ({size / 1e6:.1f} MB)" for path, size in sizes), json=json)
    if browser and page is not None:
        typer.launch(page.resolve().as_uri())
    check_trust_of_files(*results)


MarkdownOption = Annotated[bool, Option("--markdown", help="Print the table as Markdown.")]


@on_scene
def explain(*, knee: RunOptions, markdown: MarkdownOption = False, json: terminal.JsonOption = None) -> None:
    """Show the cost and action of each effect of a scene: equations, time, stiffness, and energy over the run.

    Example: `pftwin explain --case 2`
    """
    terminal.check_outputs(json)
    chosen = knee.load()
    from pftwin.studies.audit.explain import explain as look
    from pftwin.studies.audit.report import explanation_sheet

    with terminal.progress(f"running {chosen.scene.name}") as shown:
        found = look(chosen.scene, integrator=knee.method, dt=knee.dt, progress=terminal.progress_callback(shown))
    facts = {"contact": chosen.contact, **found.to_dict(), "machine": describe()}
    terminal.present(facts, explanation_sheet(found), json=json, markdown=markdown)


@on_scene
def audit(
    *,
    knee: RunOptions,
    out_dir: Annotated[Path | None, Option("--out", metavar="DIR", help="Folder for figure, CSV and NetCDF.")] = None,
    tolerance: Annotated[
        str, Option(metavar="LENGTH", help="Change of the path above which an effect matters [mm].")
    ] = "0.1 mm",
    markdown: MarkdownOption = False,
    json: terminal.JsonOption = None,
) -> None:
    """Show the influence of each effect of a scene: how the result changes without it, and the time it takes.

    Effects that the scene lacks are added; inertia is doubled, halved and removed; steps are halved.

    Example: `pftwin audit --case 2 --out audit`
    """
    if (allowed := amount(tolerance, "mm", "--tolerance")) <= 0:
        raise InputError(f"found {tolerance!r}", where="--tolerance", expected="a positive length")
    if out_dir is not None:
        terminal.check_folder(out_dir)
    terminal.check_outputs(json)
    chosen = knee.load()
    from pftwin.studies.audit.audit import audit as weigh
    from pftwin.studies.audit.report import audit_sheet

    with terminal.progress(f"running {chosen.scene.name}") as shown:
        options = {"integrator": knee.method, "dt": knee.dt, "progress": terminal.progress_callback(shown)}
        found = weigh(chosen.scene, tolerance=1e-3 * allowed, **options)
    files = [] if out_dir is None else _write(found, out_dir)
    about = {"contact": chosen.contact, "machine": describe(), "files": [str(p) for p in files]}
    terminal.present({**found.to_dict(), **about}, audit_sheet(found), json=json, markdown=markdown)
    if found.interrupted:
        raise Interrupted(*files, json)
    terminal.show(terminal.written_line(files), json=json)
    if found.verdict != "valid":
        exit_flagged(f"{found.verdict} ({found.scene})")


def _write(found: Audit, folder: Path) -> list[Path]:
    """Writes tables and figure and returns their paths; after an interrupt only the tables, to end quickly."""
    from pftwin.base.sheet import to_csv
    from pftwin.base.text_files import write_text
    from pftwin.files.result_files import save_dataset
    from pftwin.results.plots import save_figure
    from pftwin.studies.audit.report import audit_figure, dataset, table

    csv, netcdf, *figures = files = [folder / f"audit.{kind}" for kind in ("csv", "nc", "png", "svg")]
    with report_written_on_interrupt(*files):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(csv, to_csv(table(found)))
        save_dataset(dataset(found), netcdf)
        if found.interrupted:
            return [csv, netcdf]
        title = f"{found.scene}: influence of each effect"
        save_figure(audit_figure(found, title), figures[0].with_suffix(""))
    return files
