"""`pftwin twin`."""

from __future__ import annotations

import base64
import gzip
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from pftwin.base.errors import InputError
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, check_suffix, present, spinner

if TYPE_CHECKING:
    from pftwin.model.scene import Scene

MOST_BYTES = 1_500_000  # of a page


def twin(
    scene: SceneArgument = None,
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="TWIN.html", help="File for the page.")],
    case: CaseOption = None,
    contact: ContactOption = None,
    browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
    json: JsonOption = None,
) -> None:
    """Write the twin as one page that simulates at every move of its sliders, offline and without Python.

    Example: `pftwin twin --case 2 -o twin.html`
    """
    check_suffix(output, [".html", ".htm"], "the page is HTML")
    check_outputs(output, json)
    chosen = chosen_scene(scene, case, contact)
    from pftwin.base.text_files import write_text

    synthetic = chosen.scene.synthetic
    with spinner(f"compiling {chosen.scene.name}, about half a minute"):
        page = twin_page(chosen.scene)
    write_text(output, page)
    size = len(page.encode("utf-8"))
    present(
        {"scene": chosen.scene.name, "file": str(output), "bytes": size, "synthetic": synthetic},
        "",
        f"written: {output} ({size / 1e6:.1f} MB)",
        json=json,
    )
    if browser:
        typer.launch(output.resolve().as_uri())


def twin_page(scene: Scene) -> str:
    """Renders the page of a scene, with sliders for the tibial tuberosity and both tendons.

    Raises InputError for a scene that cannot be compiled for a page (contacts on meshes), or too large a page.
    """
    from fitting.cli.live.knobs import Knobs
    from fitting.cli.live.words import AFTER, BEFORE, NOT_FOR_PATIENTS
    from fitting.cli.pages import template
    from fitting.cli.twin.programs import facts, missing, programs, sliders
    from pftwin.model.scene import check

    check(scene)
    knobs = Knobs.of(scene)
    made = programs(knobs)
    page = template("twin.html").render(
        facts={**made.facts, **facts(scene, sliders(knobs), missing(knobs))},
        wasm=base64.b64encode(gzip.compress(made.binary, 9, mtime=0)).decode("ascii"),
        before=BEFORE,
        after=AFTER,
        not_for_patients=NOT_FOR_PATIENTS,
    )
    size = len(page.encode("utf-8"))
    if size > MOST_BYTES:
        raise InputError(
            f"a page of {size / 1e6:.1f} MB",
            where="twin",
            expected=f"at most {MOST_BYTES / 1e6:.1f} MB",
            remedy="a shorter motion or fewer frames; pftwin app has no such limit",
        )
    return page
