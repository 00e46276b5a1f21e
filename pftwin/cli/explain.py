"""`pftwin explain`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from pftwin.cli.scenes import (
    CaseOption,
    ContactOption,
    IntegratorOption,
    SceneArgument,
    StepOption,
    chosen_scene,
    integrator_of,
)
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json

if TYPE_CHECKING:
    from rich.console import Console

    from pftwin.studies.tables import Sheet

MarkdownOption = Annotated[bool, typer.Option("--markdown", help="Print the table as Markdown.")]


def explain(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: ContactOption = None,
    integrator: IntegratorOption = None,
    dt: StepOption = None,
    markdown: MarkdownOption = False,
    json: JsonOption = None,
) -> None:
    """Say what each effect of a scene adds: equations, time, stiffness, and the energy it moved over the run.

    Example: `pftwin explain --case 2`
    """
    check_outputs(json)
    chosen = chosen_scene(scene, case, contact)
    from pftwin.studies.audit.explain import explain as look
    from pftwin.studies.audit.report import explanation_sheet

    with working(f"running {chosen.scene.name} with and without each effect"):
        found = look(chosen.scene, integrator=integrator_of(integrator), dt=dt or 1e-3)
    from pftwin.base.runtime import describe

    write_json({"contact": chosen.contact, **found.to_dict(), "machine": describe()}, json)
    show(explanation_sheet(found), out(json), markdown)


def show(sheet: Sheet, console: Console, markdown: bool) -> None:
    """The table and its notes."""
    if markdown:
        console.print(sheet.markdown(), markup=False, highlight=False)
        return
    console.print(sheet.table())
    for note in sheet.notes:
        console.print(note, markup=False, highlight=False)
