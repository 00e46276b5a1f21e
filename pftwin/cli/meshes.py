"""`pftwin fit-surface`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.written_amounts import amount, axis_named
from pftwin.cli import terminal
from pftwin.cli.plugins import with_former_names

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.fit import PatchFit


@with_former_names({"tolerance": "--tolerance-mm", "half_width": "--half-width-mm"})
def fit_surface(
    mesh: Annotated[Path, Argument(metavar="MESH", help="STL, OBJ or PLY file of a femoral component.")],
    *,
    units: Annotated[str, Option(metavar="m|mm", help="Unit of the mesh's coordinates.")],
    kind: Annotated[str, Option(metavar="polynomial|spline", help="Polynomials, or a bicubic spline.")] = "polynomial",
    degree: Annotated[str | None, Option(metavar="LIST", help="Polynomials to fit; default P2,P4,P5.")] = None,
    tolerance: Annotated[
        str | None, Option(metavar="LENGTH", help="Rms error that a spline must reach; default 0.02 mm [mm].")
    ] = None,
    chart: Annotated[
        str | None,
        Option(
            metavar="plane|cylinder", help="Surface from which heights are measured; a spline chooses it by default."
        ),
    ] = None,
    anterior: Annotated[str, Option(help="Anterior direction in the mesh's frame.")] = "+z",
    proximal: Annotated[str, Option(help="Proximal direction in the mesh's frame.")] = "+x",
    half_width: Annotated[str, Option(metavar="LENGTH", help="Half width of the region [mm].")] = "20 mm",
    angles: Annotated[
        tuple[float, float], Option("--angles-deg", help="Angular limits of the region about the trochlear axis [deg].")
    ] = (-60.0, 60.0),
    output: Annotated[Path | None, Option("-o", "--output", metavar="FIGURE.png", help="Figure of the region.")] = None,
    json: terminal.JsonOption = None,
) -> None:
    """Find the trochlea on a mesh and fit patches to it; prints R^2 and errors, and draws the region.

    Example: `pftwin fit-surface femur.stl --units mm --anterior=-x --proximal=+y -o region.png`
    """
    terminal.check_figure(output)
    terminal.check_outputs(output, json)
    names, asked = _patches(kind, degree, tolerance)
    half = 1e-3 * amount(half_width, "mm", "--half-width", least=0)
    directions = {"anterior": _direction(anterior, "anterior"), "proximal": _direction(proximal, "proximal")}
    if chart not in (None, "plane", "cylinder"):
        raise InputError(f"no chart {chart!r}", where="--chart", expected="plane or cylinder")
    terminal.start_computing()
    from pftwin.geometry.mesh.mesh import load_mesh
    from pftwin.geometry.patch.fit import fit_named
    from pftwin.geometry.patch.region import trochlear_region

    with terminal.spinner(f"reading {mesh}"):
        surface = load_mesh(mesh, units=units)
    with terminal.spinner("searching for the trochlea"):
        limits = math.radians(angles[0]), math.radians(angles[1])
        wanted: dict[str, Any] = {"half_width": half, "angles": limits}
        try:
            region = trochlear_region(surface, **directions, **wanted)
        except InputError as error:
            raise _with_directions(error, surface, wanted, output) from None
    with terminal.spinner("fitting"):
        fits = [fit_named(surface, name, chart=chart, region=region, **asked) for name in names]
    found = [_fit_facts(f) for f in fits]
    over = found[0]["chart"]["type"]  # all fits have the same chart
    if output is not None:
        from pftwin.results.plots.region import plot_region

        with terminal.spinner("drawing"):
            terminal.save_picture(plot_region(region, surface), output)
    facts = {
        "mesh": str(mesh),
        "chart": over,
        "region_vertices": region.n_vertices,
        "region_angles_rad": list(region.angles),
        "region_half_width_m": region.half_width,
        "fits": found,
    }
    sheet = _sheet(f"{mesh.name}, heights over a {over}, {fits[0].n_vertices} vertices", fits)
    chosen = f"the chart is chosen: {fits[0].chart_chosen}" if fits[0].chart_chosen else ""
    terminal.present(facts, sheet, chosen, terminal.written_line([output]), json=json)


def _patches(kind: str, degree: str | None, tolerance: str | None) -> tuple[list[str], dict[str, float]]:
    """The names of the patches, and the options of their fit."""
    from pftwin.geometry.patch.fit import SPLINE, parse_name

    if kind not in ("polynomial", SPLINE):
        raise InputError(f"no patch {kind!r}", where="--kind", expected=f"polynomial or {SPLINE}")
    if kind == SPLINE:
        if degree is not None:
            raise InputError("a spline has no degree to choose", where="--degree", remedy="leave it out")
        return [SPLINE], {} if tolerance is None else {
            "tolerance": 1e-3 * amount(tolerance, "mm", "--tolerance", least=0)
        }
    if tolerance is not None:
        raise InputError("polynomials have no tolerance to choose", where="--tolerance", remedy="--kind spline")
    return [parse_name(name) for name in (degree or "P2,P4,P5").split(",")], {}


def _sheet(title: str, fits: list[PatchFit]) -> Sheet:
    """The table of fits."""
    headings = ("patch", "R^2 [%]", "rms [mm]", "max [mm]", "rms along normal [mm]")
    rows = (
        (f.name, f"{100 * f.r_squared:.2f}", *(f"{1e3 * v:.3f}" for v in (f.rms, f.max_error, f.rms_normal)))
        for f in fits
    )
    return Sheet(title, headings, tuple(rows), words=())


def _with_directions(
    error: InputError, surface: SurfaceMesh, wanted: dict[str, Any], output: Path | None
) -> InputError:
    """The error of a region search with directions as a remedy, which are drawn if there is an `output`.

    They are options that give a region, along the mesh's axes or else its principal axes, or else the latter.
    """
    import numpy as np

    from pftwin.geometry.patch.region import directions_with_groove, principal_axes

    axes = principal_axes(surface)
    both = [s * a.direction for a in axes for s in (1, -1)]
    turned = {",".join(f"{v:.3f}" for v in np.round(d, 3) + 0.0): d for d in both}  # no "-0.000"
    found = directions_with_groove(surface, **wanted) or directions_with_groove(surface, along=turned, **wanted)
    drawn = f"{output or '-o FIGURE.png'} shows them"
    if output is not None:
        from pftwin.results.plots.region import plot_directions

        terminal.save_picture(plot_directions(found, axes, surface), output)
    if found:
        options = " or ".join(f"--anterior={c.anterior} --proximal={c.proximal}" for c in found)
        remedy = f"{options}: along these directions a groove is found; {drawn}"
    else:
        own = "" if error.remedy is None else f"{error.remedy}; "
        remedy = f"{own}principal directions: {' or '.join([*turned][::2])}; {drawn}"
    return InputError(error.problem, where=error.where, expected=error.expected, remedy=remedy)


def _direction(text: str, name: str) -> tuple[float, ...]:
    """Parses a signed axis ("-x") or three numbers ("0,1,0")."""
    if (axis := axis_named(text)) is not None:
        return axis
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3:
        raise InputError(f"found {text!r}", where=f"--{name}", expected="an axis as in -x, or three numbers: 0,1,0")
    return values


def _fit_facts(f: PatchFit) -> dict[str, Any]:
    """A fit for JSON, with chart and coefficients in the format of scene files."""
    import numpy as np

    from pftwin.base.spatial import Quaternion

    spline, chart = f.name == "spline", f.patch.chart
    radius = chart.axis_radius
    return {
        "name": f.name,
        **({} if spline else {"polynomial": f.name}),
        "r_squared": f.r_squared,
        "rms_m": f.rms,
        "max_error_m": f.max_error,
        "rms_normal_m": f.rms_normal,
        "max_error_normal_m": f.max_error_normal,
        "vertices": f.n_vertices,
        "coverage": f.coverage,
        "chart_chosen": f.chart_chosen,
        "spline_coefficients_m" if spline else "coefficients_m": np.asarray(f.patch.coefficients).tolist(),
        "chart": {
            "type": "plane" if radius is None else "cylinder",
            "origin_m": [float(getattr(chart.origin, k)) for k in "xyz"],
            "quaternion_wxyz": [float(getattr(Quaternion.from_rotation(chart.axes), k)) for k in "wxyz"],
            **({} if radius is None else {"radius_m": float(radius)}),
        },
        "center_m": [float(v) for v in f.patch.center],
        "half_size_m": [float(v) for v in f.patch.half_size],
    }
