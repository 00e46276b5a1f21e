"""`pftwin fit-surface`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.base.errors import InputError, OutputError
from pftwin.cli.terminal import JsonOption, check_outputs, out, start_computing, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.geometry.patch.fit import PatchFit

_SIGNS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_FIGURES = (".png", ".svg", ".pdf")


def fit_surface(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="STL, OBJ or PLY file of a femoral component.")],
    *,
    units: Annotated[str, typer.Option("--units", metavar="m|mm", help="Unit of the mesh's coordinates.")],
    kind: Annotated[
        str, typer.Option("--kind", metavar="polynomial|spline", help="Polynomials, or a bicubic spline.")
    ] = "polynomial",
    degree: Annotated[
        str | None, typer.Option("--degree", metavar="LIST", help="Polynomials to fit; P2,P4,P5 if left out.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance-mm", help="Rms that a spline is to reach; 0.02 if left out [mm].")
    ] = None,
    chart: Annotated[str, typer.Option("--chart", metavar="plane|cylinder", help="Heights over what.")] = "plane",
    anterior: Annotated[str, typer.Option("--anterior", help="Anterior direction in the mesh's frame.")] = "+z",
    proximal: Annotated[str, typer.Option("--proximal", help="Proximal direction in the mesh's frame.")] = "+x",
    half_width: Annotated[float, typer.Option("--half-width-mm", help="Half width of the region [mm].")] = 20.0,
    angles: Annotated[
        tuple[float, float], typer.Option("--angles-deg", help="Region's limits about the trochlear axis [deg].")
    ] = (-60.0, 60.0),
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FIGURE.png", help="Figure of the region.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find the trochlea on a mesh and fit patches to it: table of R^2 and errors, and a figure of the region.

    Example: `pftwin fit-surface femur.stl --units mm --anterior=-x --proximal=+y -o region.png`
    """
    if output is not None and output.suffix.lower() not in _FIGURES:
        raise OutputError(f"{output}: unknown kind of figure; expected: {', '.join(_FIGURES)}")
    check_outputs(output, json)
    names, asked = _patches(kind, degree, tolerance)
    directions = {"anterior": _direction(anterior, "anterior"), "proximal": _direction(proximal, "proximal")}
    if chart not in ("plane", "cylinder"):
        raise InputError(f"no chart {chart!r}", where="--chart", expected="plane or cylinder")
    start_computing()
    import numpy as np

    from pftwin.geometry.mesh.mesh import load_mesh
    from pftwin.geometry.patch.fit import fit_named
    from pftwin.geometry.patch.region import trochlear_region

    with working(f"reading {mesh}"):
        surface = load_mesh(mesh, units=units)
    with working("looking for the trochlea"):
        limits = float(np.radians(angles[0])), float(np.radians(angles[1]))
        region = trochlear_region(surface, **directions, half_width=1e-3 * half_width, angles=limits)
    with working("fitting"):
        fits = [fit_named(surface, name, chart=chart, region=region, **asked) for name in names]
    if output is not None:
        with working("drawing"):
            _draw(region, surface, output)
    write_json(_facts(mesh, chart, region, fits), json)
    console = out(json)
    console.print(_table(mesh, chart, fits))
    if output is not None:
        console.print(f"written: {output}", markup=False, highlight=False)


def _patches(kind: str, degree: str | None, tolerance: float | None) -> tuple[list[str], dict[str, float]]:
    """The patches' names, and what else is asked of them."""
    from pftwin.geometry.patch.fit import SPLINE, parse_name

    if kind not in ("polynomial", SPLINE):
        raise InputError(f"no patch {kind!r}", where="--kind", expected=f"polynomial or {SPLINE}")
    if kind == SPLINE:
        if degree is not None:
            raise InputError("a spline has no degree to choose", where="--degree", remedy="leave it out")
        return [SPLINE], {} if tolerance is None else {"tolerance": 1e-3 * tolerance}
    if tolerance is not None:
        raise InputError("polynomials reach what they reach", where="--tolerance-mm", remedy="--kind spline")
    return [parse_name(name) for name in (degree or "P2,P4,P5").split(",")], {}


def _direction(text: str, name: str) -> tuple[float, ...]:
    """A signed axis ("-x") or three numbers ("0,1,0")."""
    axis = text.strip().lower().removeprefix("+")
    if axis.removeprefix("-") in _SIGNS:
        sign = -1.0 if axis.startswith("-") else 1.0
        return tuple(sign * v for v in _SIGNS[axis.removeprefix("-")])
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3:
        raise InputError(f"found {text!r}", where=f"--{name}", expected="an axis as in -x, or three numbers: 0,1,0")
    return values


def _draw(region: Any, surface: Any, output: Path) -> None:
    from pftwin.base.output import written_whole
    from pftwin.results.plots.region import plot_region

    figure = plot_region(region, surface)
    with written_whole(output) as temporary:
        figure.savefig(temporary, dpi=150)


def _coefficients(name: str) -> str:
    """What a scene file calls the coefficients."""
    return "spline_coefficients_m" if name == "spline" else "coefficients_m"


def _chart(chart: Any) -> dict[str, Any]:
    """The chart as a scene file has it."""
    from pftwin.base.spatial import Quaternion

    radius = getattr(chart, "radius", None)
    return {
        "type": "plane" if radius is None else "cylinder",
        "origin_m": [float(getattr(chart.origin, k)) for k in "xyz"],
        "quaternion_wxyz": [float(getattr(Quaternion.from_rotation(chart.axes), k)) for k in "wxyz"],
        **({} if radius is None else {"radius_m": float(radius)}),
    }


def _facts(mesh: Path, chart: str, region: Any, fits: list[PatchFit]) -> dict[str, Any]:
    import numpy as np

    return {
        "mesh": str(mesh),
        "chart": chart,
        "region_vertices": region.n_vertices,
        "region_angles_rad": list(region.angles),
        "region_half_width_m": region.half_width,
        "fits": [
            {
                "name": f.name,
                **({} if f.name == "spline" else {"polynomial": f.name}),
                "r_squared": f.r_squared,
                "rms_m": f.rms,
                "max_error_m": f.max_error,
                "rms_normal_m": f.rms_normal,
                "max_error_normal_m": f.max_error_normal,
                "vertices": f.n_vertices,
                "coverage": f.coverage,
                _coefficients(f.name): np.asarray(f.patch.coefficients).tolist(),
                "chart": _chart(f.patch.chart),
                "center_m": [float(v) for v in f.patch.center],
                "half_size_m": [float(v) for v in f.patch.half_size],
            }
            for f in fits
        ],
    }


def _table(mesh: Path, chart: str, fits: list[PatchFit]) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(f"{mesh.name}, heights over a {chart}, {fits[0].n_vertices} vertices"))
    for heading in ("patch", "R^2 [%]", "rms [mm]", "max [mm]", "rms along normal [mm]"):
        table.add_column(escape(heading), justify="right")
    for f in fits:
        errors = (1e3 * v for v in (f.rms, f.max_error, f.rms_normal))
        table.add_row(f.name, f"{100 * f.r_squared:.2f}", *(f"{v:.3f}" for v in errors))
    return table
