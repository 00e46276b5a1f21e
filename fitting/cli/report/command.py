"""`pftwin report`."""

from __future__ import annotations

import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from fitting.cli.pages import template
from pftwin.base.errors import InputError, MissingExtraError
from pftwin.cli.exit_codes import exit_flagged
from pftwin.cli.scenes import CaseOption, ContactOption
from pftwin.cli.terminal import JsonOption, check_outputs, check_suffix, present, spinner, start_computing

if TYPE_CHECKING:
    from fitting.cli.report.material import Material

MOST_BYTES = 12_000_000  # of a page


def report(
    source: Annotated[Path, Argument(metavar="FIT.json|DEMO|RESULT.nc", help="A fit, the demo's folder, or a result.")],
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="REPORT.html", help="File for the page.")],
    treatment: Annotated[Path | None, Option(metavar="VARIANTS.nc", help="A prediction from `pftwin treat`.")] = None,
    scene: Annotated[Path | None, Option(metavar="SCENE.toml", help="The scene that was fitted or simulated.")] = None,
    case: CaseOption = None,
    contact: ContactOption = None,
    browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
    json: JsonOption = None,
) -> None:
    """Report a fit or a result on one page that opens offline: the verdict, the knee in three dimensions, the effect of
    a treatment and its uncertainty; an appendix with parameters, data quality, figures and settings.

    Example: `pftwin report fit.json --treatment variants.nc -o report.html`
    """
    check_suffix(output, [".html", ".htm"], "the page is HTML")
    check_outputs(output, json)
    start_computing()
    from fitting.cli.report.material import gather_material
    from pftwin.base.text_files import write_text

    material = gather_material(source, treatment=treatment, scene=scene, case=case, contact=contact)
    given = {"--treatment": treatment, "--scene": scene, "--case": case, "--contact": contact}
    options = [part for name, value in given.items() if value is not None for part in (name, str(value))]
    with spinner("drawing"):
        page, viewer = report_page(material, shlex.join(["pftwin", "report", str(source), *options, "-o", output.name]))
        write_text(output, page)
    size = output.stat().st_size
    facts = {"source": str(source), "file": str(output), "bytes": size, "viewer": viewer}
    left_out = "" if viewer else "the page lacks the knee in three dimensions, and says why"
    written = f"written: {output} ({size / 1e6:.1f} MB)"
    present({**facts, "synthetic": material.synthetic()}, left_out, written, json=json)
    if browser:
        typer.launch(output.resolve().as_uri())
    if invalid := material.invalid():
        exit_flagged("; ".join(invalid))


def report_page(material: Material, command: str) -> tuple[str, bool]:
    """Renders the page, with the command line that made it; returns also whether it shows the knee in 3D."""
    from fitting.cli.report import figures, tables
    from fitting.prediction.plots import main_finding

    now = tables.stamp(datetime.now(UTC))

    def page(view: str, no_view: str = "") -> str:
        about = {"m": material, "t": tables, "f": figures, "finding": main_finding, "command": command, "now": now}
        return template("report.html").render(**about, view=view, no_view=no_view)

    try:
        view = figures.viewer(material)
    except (MissingExtraError, InputError) as error:
        return page("", f"Not drawn: {error}"), False
    text = page(view)
    size = len(text.encode("utf-8"))
    if size <= MOST_BYTES:
        return text, True
    why = (
        f"Left out: with it this page would have {size / 1e6:.0f} MB, more than the {MOST_BYTES / 1e6:.0f} MB that "
        "mail lets through. `pftwin view` draws it as a page of its own."
    )
    return page("", why), False
