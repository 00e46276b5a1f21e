"""`pftwin doctor-mesh`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.cli import terminal
from pftwin.cli.exit_codes import exit_flagged

if TYPE_CHECKING:
    from pftwin.geometry.mesh.doctor import Diagnosis
    from pftwin.geometry.patch.region import Candidate, PrincipalAxis

_SEVERITIES = {"safe": "can be repaired", "left": "stays as it is", "fatal": "makes it unusable"}
_MOST_PARTS = 5  # largest number of a mesh's parts to describe


def doctor_mesh(
    mesh: Annotated[Path, Argument(metavar="FILE", help="STL, OBJ or PLY file.")],
    *,
    units: Annotated[str | None, Option(metavar="m|mm", help="Unit of the coordinates; guessed if not given.")] = None,
    repair: Annotated[Path | None, Option(metavar="OUT", help="Write the mesh, repaired where that is safe.")] = None,
    output: Annotated[
        Path | None, Option("-o", "--output", metavar="FIGURE.png", help="Figure of the proposed axes.")
    ] = None,
    json: terminal.JsonOption = None,
) -> None:
    """Find defects of a mesh: duplicate and empty triangles, winding, holes, non-manifold edges, parts, scale.

    Repairs only defects whose repair keeps the surface unchanged, in the file's own unit. Proposes axes: those of the
    mesh's frame along which there is a trochlear groove, or else the principal directions.

    Example: `pftwin doctor-mesh femur.stl --units mm --repair femur_repaired.stl -o axes.png`
    """
    from pftwin.geometry.mesh.doctor import examine_file
    from pftwin.geometry.mesh.files import check_format, read_triangles

    if repair is not None:
        check_format(repair)
        if repair.resolve() == mesh.resolve():
            raise InputError(
                "is the examined mesh itself", where="--repair", expected="another file: the mesh is not overwritten"
            )
    terminal.check_figure(output)
    terminal.check_outputs(repair, output, json)
    with terminal.spinner(f"examining {mesh}"):
        found = examine_file(mesh, units=units)
    facts, parts = found.facts(), list[Sheet | str](_description(found, units))
    if found.findings:
        first = (", ".join(f"{x:.4g}" for x in f.places[0]) if f.places else "" for f in found.findings)
        rows = tuple(
            (f.kind, _SEVERITIES[f.severity], f.words, at) for f, at in zip(found.findings, first, strict=True)
        )
        parts.append(Sheet(found.source, ("finding", "", "what", "where (first)"), rows))
    parts.append(f"verdict: {found.verdict}")
    if repair is not None:
        from pftwin.geometry.mesh.doctor import repaired
        from pftwin.geometry.mesh.mesh import save_mesh

        with terminal.spinner("repairing"):
            healed, after = repaired(*read_triangles(mesh), source=str(mesh), units=units)
        save_mesh(healed, repair)  # coordinates stay in the file's unit
        facts["repaired"] = {**after.facts(), "file": str(repair)}
        parts.append(f"written: {repair}, {after.n_faces} triangles: {after.verdict}")
    unit = units or next(iter(found.units), None)
    if unit is None or found.of("fatal"):
        why = "no unit suits its size: say which with --units" if unit is None else "the mesh is not to be used"
        parts.append(f"no axes computed: {why}")
    else:
        facts["axes"], more = _axes(mesh, unit, output)
        parts.extend(more)
    terminal.present(facts, *parts, json=json)
    if found.of("fatal"):
        exit_flagged(f"{mesh}: {found.verdict}")


def _description(found: Diagnosis, units: str | None) -> Iterator[str]:
    guess = f"stated: {units}" if units else f"likely unit: {' or '.join(found.units) or 'none'}"
    yield f"{found.n_faces} triangles on {found.n_vertices} vertices, longest side {found.longest_side:.4g} ({guess})"
    for k, part in enumerate(found.parts[:_MOST_PARTS], start=1):
        rims = sum(not loop.is_hole for loop in part.loops)
        kind = "closed" if not part.loops else f"open: {rims} rims, {len(part.loops) - rims} holes"
        yield f"part {k}: {len(part.faces)} triangles, area {part.area:.4g}, {kind}"
    if (more := len(found.parts) - _MOST_PARTS) > 0:
        yield f"and {more} smaller parts"


def _axes(mesh: Path, unit: str, output: Path | None) -> tuple[dict[str, Any], list[str]]:
    """Candidates for the anatomical axes, as facts and as lines; writes their figure if requested."""
    terminal.start_computing()
    from pftwin.geometry.mesh.mesh import load_mesh
    from pftwin.geometry.patch.region import directions_with_groove, principal_axes

    with terminal.spinner("searching for axes"):
        surface = load_mesh(mesh, units=unit, size=None, repair=True)
        grooves, axes = directions_with_groove(surface), principal_axes(surface)
    if output is not None:
        from pftwin.results.plots.region import plot_directions

        with terminal.spinner("drawing"):
            terminal.save_picture(plot_directions(grooves, axes, surface), output)
    facts = {
        "unit": unit,
        "grooves": [{"anterior": c.anterior, "proximal": c.proximal, "angles_rad": c.region.angles} for c in grooves],
        "principal": [{"direction": a.direction, "extent_m": a.extent} for a in axes],
    }
    lines = list(_along_grooves(grooves) if grooves else _along_principal(axes))
    return facts, [*lines, terminal.written_line([output])]


def _along_grooves(grooves: list[Candidate]) -> Iterator[str]:
    for c in grooves:
        low, high = (math.degrees(a) for a in c.region.angles)
        deep = 1e3 * max(c.region.groove_depth)
        options = f"--anterior={c.anterior} --proximal={c.proximal}"
        yield f"a groove along {options}: {deep:.1f} mm deep, from {low:.0f} to {high:.0f} deg about its axis"
    if len(grooves) > 1:
        yield "to see which of them is the trochlea, draw them: -o axes.png"


def _along_principal(axes: tuple[PrincipalAxis, ...]) -> Iterator[str]:
    yield "no trochlear groove is found along its axes"
    for k, axis in enumerate(axes, start=1):
        components = ", ".join(f"{round(float(x), 3) + 0.0:.3f}" for x in axis.direction)  # no "-0.000"
        yield f"principal direction {k}: ({components}), {1e3 * axis.extent:.1f} mm long"
