"""`pftwin explain` and `pftwin audit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from pftwin.base.errors import InputError
from pftwin.base.runtime import describe
from pftwin.base.written_amounts import amount
from pftwin.cli.exit_codes import Interrupted, exit_flagged, report_written_on_interrupt
from pftwin.cli.scenes import RunOptions, on_scene
from pftwin.cli.terminal import JsonOption, check_folder, check_outputs, present, progress, show, told_by, written_line

if TYPE_CHECKING:
    from pftwin.studies.audit.audit import Audit

MarkdownOption = Annotated[bool, Option("--markdown", help="Print the table as Markdown.")]


@on_scene
def explain(*, knee: RunOptions, markdown: MarkdownOption = False, json: JsonOption = None) -> None:
    """Show the cost and action of each effect of a scene: equations, time, stiffness, and energy over the run.

    Example: `pftwin explain --case 2`
    """
    check_outputs(json)
    chosen = knee.load()
    from pftwin.studies.audit.explain import explain as look
    from pftwin.studies.audit.report import explanation_sheet

    with progress(f"running {chosen.scene.name}") as shown:
        found = look(chosen.scene, integrator=knee.method, dt=knee.dt, progress=told_by(shown))
    facts = {"contact": chosen.contact, **found.to_dict(), "machine": describe()}
    present(facts, explanation_sheet(found), json=json, markdown=markdown)


@on_scene
def audit(
    *,
    knee: RunOptions,
    out_dir: Annotated[Path | None, Option("--out", metavar="DIR", help="Folder for figure, CSV and NetCDF.")] = None,
    tolerance: Annotated[
        str, Option(metavar="LENGTH", help="Change of the path above which an effect matters [mm].")
    ] = "0.1 mm",
    markdown: MarkdownOption = False,
    json: JsonOption = None,
) -> None:
    """Show the influence of each effect of a scene: how the result changes without it, and the time it takes.

    Effects that the scene lacks are added; inertia is doubled, halved and removed; steps are halved.

    Example: `pftwin audit --case 2 --out audit`
    """
    if (allowed := amount(tolerance, "mm", "--tolerance")) <= 0:
        raise InputError(f"found {tolerance!r}", where="--tolerance", expected="a positive length")
    if out_dir is not None:
        check_folder(out_dir)
    check_outputs(json)
    chosen = knee.load()
    from pftwin.studies.audit.audit import audit as weigh
    from pftwin.studies.audit.report import audit_sheet

    with progress(f"running {chosen.scene.name}") as shown:
        options = {"integrator": knee.method, "dt": knee.dt, "progress": told_by(shown)}
        found = weigh(chosen.scene, tolerance=1e-3 * allowed, **options)
    files = [] if out_dir is None else _write(found, out_dir)
    about = {"contact": chosen.contact, "machine": describe(), "files": [str(p) for p in files]}
    present({**found.to_dict(), **about}, audit_sheet(found), json=json, markdown=markdown)
    if found.interrupted:
        raise Interrupted(*files, json)
    show(written_line(files), json=json)
    if found.verdict != "valid":
        exit_flagged(f"{found.verdict} ({found.scene})")


def _write(found: Audit, folder: Path) -> list[Path]:
    """Writes tables and figure and returns their paths; after an interrupt only the tables, to end quickly."""
    from pftwin.base.text_files import write_text
    from pftwin.files.result_files import save_dataset
    from pftwin.results.plots import save_figure
    from pftwin.studies.audit.report import audit_figure, dataset, table
    from pftwin.studies.tables import to_csv

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
