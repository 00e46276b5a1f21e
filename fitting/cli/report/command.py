"""`pftwin report`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from pftwin.base.errors import OutputError
from pftwin.cli.scenes import CaseOption, ContactOption
from pftwin.cli.terminal import JsonOption, check_outputs, out, start_computing, working, write_json


def report(
    source: Annotated[
        Path, typer.Argument(metavar="FIT.json|DEMO|RESULT.nc", help="A fit, the demo's folder, or a result.")
    ],
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT.html", help="The page.")],
    treatment: Annotated[
        Path | None, typer.Option("--treatment", metavar="VARIANTS.nc", help="A prediction of `pftwin treat`.")
    ] = None,
    scene: Annotated[
        Path | None, typer.Option("--scene", metavar="SCENE.toml", help="The scene that was fitted or simulated.")
    ] = None,
    case: CaseOption = None,
    contact: ContactOption = None,
    browser: Annotated[bool, typer.Option("--open", help="Show the page in the browser.")] = False,
    json: JsonOption = None,
) -> None:
    """Tell a fit or a result on one page that opens offline: scene, data quality, fit, treatment, figures, the knee.

    Example: `pftwin report fit.json --treatment variants.nc -o report.html`
    """
    if output.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{output}: the page is HTML; try: {output.with_suffix('.html')}")
    check_outputs(output, json)
    start_computing()
    from fitting.cli.report.contents import report as told
    from fitting.cli.report.material import gathered
    from pftwin.base.text_files import write_text

    material = gathered(source, treatment=treatment, scene=scene, case=case, contact=contact)
    asked = ["pftwin", "report", str(source), *_given(treatment, scene, case, contact), "-o", output.name]
    with working("drawing"):
        page, viewer = told(material, shlex.join(asked))
        write_text(output, page)
    size = output.stat().st_size
    facts = {"source": str(source), "file": str(output), "bytes": size, "viewer": viewer}
    write_json({**facts, "synthetic": material.synthetic()}, json)
    console = out(json)
    if not viewer:
        console.print("the knee in three dimensions is not in the page, which says why", markup=False, highlight=False)
    console.print(f"written: {output} ({size / 1e6:.1f} MB)", markup=False, highlight=False)
    if browser:
        typer.launch(output.resolve().as_uri())


def _given(treatment: Path | None, scene: Path | None, case: int | None, contact: str | None) -> list[str]:
    """Options as they were given."""
    options = {"--treatment": treatment, "--scene": scene, "--case": case, "--contact": contact}
    return [part for name, value in options.items() if value is not None for part in (name, str(value))]
