"""`pftwin export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json

OutputOption = Annotated[
    list[Path],
    typer.Option(
        "-o", "--output", metavar="OUT.(mot|sto|glb|csv)", help="The suffix chooses the format; again for more."
    ),
]


def export(
    result: Annotated[Path, typer.Argument(metavar="RESULT.nc", help="A result of `pftwin simulate`.")],
    *,
    output: OutputOption,
    json: JsonOption = None,
) -> None:
    """Write a result for other programs.

    .mot: joint coordinates for OpenSim, in degrees. .sto: everything, for OpenSim. .glb: the moving knee, glTF 2.0.
    .csv: everything, as a table.

    Example: `pftwin export case2.nc -o case2.mot -o case2.glb`
    """
    from pftwin.files.interchange.exporting import check_format
    from pftwin.files.interchange.exporting import export as write

    for path in output:
        check_format(path)
    check_outputs(*output, json)
    for path in output:
        with working(f"writing {path}"):
            write(result, path)
    sizes = {str(p): p.stat().st_size for p in output}
    write_json({"result": str(result), "files": sizes}, json)
    for path, size in sizes.items():
        out(json).print(f"written: {path} ({size / 1e6:.2f} MB)", markup=False, highlight=False)
