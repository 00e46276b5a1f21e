"""`pftwin import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.base.errors import InputError
from pftwin.cli.exit_codes import flagged
from pftwin.cli.terminal import JsonOption, check_folder, check_outputs, out, start_computing, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.files.interchange.osim_scene import Imported

_MOST_NAMES = 60  # letters of them in a row at the terminal; the file has all


def import_model(
    model: Annotated[Path, typer.Argument(metavar="MODEL.osim", help="A model of OpenSim 4.")],
    *,
    folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the scene.")],
    motion: Annotated[
        Path | None,
        typer.Option(
            "--motion", metavar="COORDINATES.mot", help="Coordinates over time; the knee is bent if left out."
        ),
    ] = None,
    bend: Annotated[str | None, typer.Option("--bend", metavar="COORDINATE", help="The one to bend by.")] = None,
    side: Annotated[str | None, typer.Option("--side", metavar="right|left", help="Where the model has both.")] = None,
    femur: Annotated[str | None, typer.Option("--femur", metavar="BODY", help="If its name does not tell.")] = None,
    tibia: Annotated[str | None, typer.Option("--tibia", metavar="BODY", help="If its name does not tell.")] = None,
    patella: Annotated[str | None, typer.Option("--patella", metavar="BODY", help="If its name does not tell.")] = None,
    geometry: Annotated[
        list[Path] | None, typer.Option("--geometry", metavar="DIR", help="Where meshes are, besides; again for more.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Write a scene folder from an OpenSim model: patella, ligaments, contact meshes, motion by coordinates.

    Says what was left out and why; not_imported.md in the folder has the whole list. Ends with exit code 3 where the
    scene has been written and needs something more before it can be simulated.

    Example: `pftwin import lenhart2015.osim -o knee`
    """
    check_folder(folder)
    check_outputs(json)
    from pftwin.files.interchange.osim_scene import import_osim

    with working(f"reading {model}"):
        found = import_osim(
            model,
            folder,
            motion=motion,
            bend=bend,
            side=side,
            femur=femur,
            tibia=tibia,
            patella=patella,
            geometry=geometry or (),
        )
    trouble = _trouble(found)
    write_json({**_facts(found), "trouble": trouble}, json)
    console = out(json)
    for note in found.notes:
        console.print(note, markup=False, highlight=False)
    console.print(_table(found))
    console.print(f"written: {', '.join(str(p) for p in found.files)}", markup=False, highlight=False)
    if trouble is not None:
        flagged(trouble)
    console.print(f"next: pftwin simulate {found.scene} -o knee.nc", markup=False, highlight=False)


def _trouble(found: Imported) -> str | None:
    """Why the scene cannot be loaded as it is; None where it can."""
    start_computing()
    from pftwin.files.scene_file import load_scene_file

    with working("loading the scene"):
        try:
            scene = load_scene_file(found.scene).scene
        except InputError as error:
            return str(error)
    return None if scene.contact is not None else f"{found.scene}: a scene without contact"


def _facts(found: Imported) -> dict[str, Any]:
    return {
        "files": [str(p) for p in found.files],
        "notes": found.notes,
        "not_imported": [part._asdict() for part in found.left_out],
    }


def _table(found: Imported) -> Table:
    from rich.markup import escape
    from rich.table import Table

    from pftwin.files.interchange.osim_toml import rows

    table = Table(title="not imported")
    for name in ("what", "names", "why"):
        table.add_column(name)
    for kind, names, why in rows(found.left_out):
        short = names if len(names) <= _MOST_NAMES else f"{names[:_MOST_NAMES]} ... ({names.count(',') + 1})"
        table.add_row(*(escape(cell) for cell in (kind, short, why)))
    return table
