"""`pftwin doctor-mesh`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pftwin.cli.exit_codes import flagged
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.geometry.mesh.doctor import Diagnosis

_SEVERITIES = {"safe": "can be repaired", "left": "stays as it is", "fatal": "makes it unusable"}


def doctor_mesh(
    mesh: Annotated[Path, typer.Argument(metavar="FILE", help="STL, OBJ or PLY file.")],
    *,
    units: Annotated[
        str | None, typer.Option("--units", metavar="m|mm", help="Unit of the coordinates; guessed if not given.")
    ] = None,
    repair: Annotated[
        Path | None, typer.Option("--repair", metavar="OUT", help="Write the mesh with what is safe repaired.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Say what is wrong with a mesh: doubled and empty triangles, winding, holes, non-manifold edges, parts, scale.

    Repairs what leaves the surface as it is, in the file's own unit, and refuses what would change the answer.

    Example: `pftwin doctor-mesh femur.stl --units mm --repair femur_repaired.stl`
    """
    from pftwin.geometry.mesh.doctor import examine_file
    from pftwin.geometry.mesh.files import check_format

    if repair is not None:
        check_format(repair)
    check_outputs(repair, json)
    with working(f"examining {mesh}"):
        found = examine_file(mesh, units=units)
    console = out(json)
    facts = found.facts()
    _show(console, found, units)
    if repair is not None:
        from pftwin.geometry.mesh.doctor import repaired_file
        from pftwin.geometry.mesh.mesh import save_mesh

        with working("repairing"):
            healed, after = repaired_file(mesh, units=units)
        save_mesh(healed, repair)  # numbers as they are: the unit stays the file's
        facts["repaired"] = {**after.facts(), "file": str(repair)}
        console.print(f"written: {repair}, {after.n_faces} triangles: {after.verdict}", markup=False, highlight=False)
    write_json(facts, json)
    if found.of("fatal"):
        flagged(f"{mesh}: {found.verdict}")


def _show(console, found: Diagnosis, units: str | None) -> None:
    guess = f"stated: {units}" if units else f"likely unit: {' or '.join(found.units) or 'none'}"
    lines = [
        f"{found.n_faces} triangles on {found.n_vertices} vertices, longest side {found.longest_side:.4g} ({guess})",
        *(_part_line(k, found) for k in range(min(5, len(found.parts)))),
        *([f"and {len(found.parts) - 5} smaller parts"] if len(found.parts) > 5 else []),
    ]
    for line in lines:
        console.print(line, markup=False, highlight=False)
    if found.findings:
        console.print(_table(found))
    console.print(f"verdict: {found.verdict}", markup=False, highlight=False)


def _part_line(k: int, found: Diagnosis) -> str:
    part = found.parts[k]
    rims = sum(not loop.is_hole for loop in part.loops)
    kind = "closed" if not part.loops else f"open: {rims} rims, {len(part.loops) - rims} holes"
    return f"part {k + 1}: {len(part.faces)} triangles, area {part.area:.4g}, {kind}"


def _table(found: Diagnosis) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(found.source))
    for heading in ("finding", "", "what", "where (first)"):
        table.add_column(heading)
    for f in found.findings:
        place = ", ".join(f"{x:.4g}" for x in f.places[0]) if f.places else ""
        table.add_row(f.kind, _SEVERITIES[f.severity], escape(f.words), place)
    return table
