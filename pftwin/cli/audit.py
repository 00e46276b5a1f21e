"""`pftwin audit`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pftwin.base.errors import InputError
from pftwin.cli.exit_codes import Interrupted, keeping
from pftwin.cli.explain import MarkdownOption, show
from pftwin.cli.scenes import (
    CaseOption,
    ContactOption,
    IntegratorOption,
    SceneArgument,
    StepOption,
    chosen_scene,
    integrator_of,
)
from pftwin.cli.terminal import JsonOption, check_folder, check_outputs, out, working, write_json

if TYPE_CHECKING:
    from pftwin.studies.audit.audit import Audit


def audit(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: ContactOption = None,
    out_dir: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Figure, CSV and NetCDF go there.")
    ] = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", metavar="MM", help="What the path may be off by before it matters [mm].")
    ] = 0.1,
    integrator: IntegratorOption = None,
    dt: StepOption = None,
    markdown: MarkdownOption = False,
    json: JsonOption = None,
) -> None:
    """Say what each effect of a scene is worth: what changes when it is left out, and what it takes.

    Effects that the scene lacks and could have are put in; inertia is doubled, halved and left out; steps are halved.

    Example: `pftwin audit --case 2 --out audit`
    """
    if not (math.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"found {tolerance!r}", where="--tolerance", expected="a positive number of millimetres")
    files = _files(out_dir)
    check_outputs(json)
    chosen = chosen_scene(scene, case, contact)
    from pftwin.studies.audit.audit import audit as weigh
    from pftwin.studies.audit.report import audit_sheet

    with working(f"running {chosen.scene.name} with every effect left out in turn"):
        found = weigh(chosen.scene, tolerance=1e-3 * tolerance, integrator=integrator_of(integrator), dt=dt or 1e-3)
    written = []
    if files:
        with keeping(*files.values()):
            written = _write(found, files)
    from pftwin.base.runtime import describe

    about = {"contact": chosen.contact, "machine": describe(), "files": [str(p) for p in written]}
    write_json({**found.to_dict(), **about}, json)
    console = out(json)
    show(audit_sheet(found), console, markdown)
    if found.interrupted:
        raise Interrupted(*written, *([Path(json)] if json not in (None, "-") else []))
    if written:
        console.print(f"written: {', '.join(str(p) for p in written)}", markup=False, highlight=False)


def _files(folder: Path | None) -> dict[str, Path]:
    """What is written, by kind; the folder is made later."""
    if folder is None:
        return {}
    check_folder(folder)
    return {kind: folder / f"audit.{kind}" for kind in ("csv", "nc", "png", "svg")}


def _write(found: Audit, files: dict[str, Path]) -> list[Path]:
    """What was written: after an interrupt the tables alone, for someone is waiting."""
    from pftwin.base.text_files import write_text
    from pftwin.files.result_files import save_dataset
    from pftwin.results.plots import save_figure
    from pftwin.studies.audit.report import audit_figure, dataset, table
    from pftwin.studies.tables import to_csv

    files["csv"].parent.mkdir(parents=True, exist_ok=True)
    write_text(files["csv"], to_csv(table(found)))
    save_dataset(dataset(found), files["nc"])
    if found.interrupted:
        return [files["csv"], files["nc"]]
    title = f"{found.scene}{' (synthetic motion)' if found.synthetic else ''}: what each effect is worth"
    save_figure(audit_figure(found, title), files["png"].with_suffix(""))
    return list(files.values())
