"""`pftwin init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pftwin.cli.terminal import JsonOption, check_folder, check_outputs, out, start_computing, working, write_json


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the example; made if it is not there.")],
    *,
    case: Annotated[int, typer.Option("--case", min=1, max=4, help="Case of the virtual rig.")] = 1,
    json: JsonOption = None,
) -> None:
    """Write a commented example: a scene file with the files of a laboratory (markers, forces, mesh).

    Example: `pftwin init knee`, then `pftwin simulate knee/scene.toml -o knee.nc`
    """
    check_folder(folder)
    check_outputs(json)
    from pftwin.rig.scene_template import write_example

    start_computing()
    with working(f"writing the example to {folder}"):
        written = write_example(folder, case)
    write_json({"files": [str(p) for p in written]}, json)
    console = out(json)
    for path in written:
        console.print(f"written: {path}", markup=False, highlight=False)
    console.print(f"next: pftwin simulate {folder / 'scene.toml'} -o knee.nc", markup=False, highlight=False)
