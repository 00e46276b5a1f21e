"""`pftwin demo`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from pftwin.cli.terminal import JsonOption, check_outputs, out, start_computing, write_json
from pftwin.errors import OutputError


def demo(
    *,
    folder: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = Path("demo"),
    json: JsonOption = None,
) -> None:
    """Run the virtual rig's four cases with P2, P4 and P5, and compare them with its measurements.

    Example: `pftwin demo --out demo`
    """
    check_folder(folder)
    check_outputs(json)
    start_computing()
    from pftwin.demo import run_demo

    write_json(run_demo(folder, out(json)), json)


def check_folder(folder: Path) -> None:
    """Refuses a folder that is not there and cannot be made, or cannot be written to; makes nothing.

    Raises:
        OutputError: saying why.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; try: another name for the folder")
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: cannot be made: no permission to write in {there}")
