"""Figures of a contact map, and its conversion to an xarray Dataset with units and long names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.quantities import about, annotated
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.results.plots.style import COLOURS, WIDE, house_style, legend_above
from pftwin.results.plots.style import title as name_figure
from pftwin.studies.contact_map.mapping import ContactMap, status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from xarray import Dataset


_SHOWN = 4  # number of frames with a pressure map
_AXES = "xyz"
_DARKEST, _PALEST = 0.4, 0.95  # greys of the femur's triangles: edge-on, and facing the viewer
_NAMED = 0.7  # smallest component of the lateral direction along an axis whose ends are labelled medial and lateral


def map_figure(
    found: ContactMap, femur: SurfaceMesh, button: SurfaceMesh, title: str, *, lateral: Any = None
) -> Figure:
    """Plots pressure on the button at four times, the centre of pressure on the femur, force, area and pressure.

    The meshes are in their own frames. `lateral` (2, 3) has the unit vectors to lateral in the femur's and the
    patella's frame; without it the sides are not labelled.
    """
    from matplotlib.figure import Figure

    on_femur, on_patella = (None, None) if lateral is None else lateral
    with house_style():
        figure = Figure(figsize=(WIDE, 7.6))
        parts: Any = figure.subfigures(2, 1, height_ratios=[1.35, 2.0])
        above, below = parts
        panels: Any = below.subplot_mosaic([["path", "path", "force", "force"], ["path", "path", "area", "pressure"]])
        panels |= above.subplot_mosaic([[f"map{k}" for k in range(_SHOWN)]])
        _maps(above, panels, found, button, on_patella)
        _path(panels["path"], found, femur, on_femur)
        _courses(panels, found)
        name_figure(figure, title)
    return figure


def _maps(figure: Any, panels: dict[str, Any], found: ContactMap, button: SurfaceMesh, lateral: Any) -> None:
    """Draws the button seen from the loaded side, whose normals point to the viewer."""
    from matplotlib import colormaps
    from matplotlib.collections import PolyCollection

    pressed = found.pressure.sum(axis=0, dtype=np.float64)
    outwards = (pressed if pressed.any() else np.ones_like(pressed)) @ button.area_vectors
    across, up = _plane(outwards)
    corners = 1e3 * button.vertices[button.faces]
    frames = np.flatnonzero(found.touching)
    shown = frames[np.linspace(0, len(frames) - 1, _SHOWN).round().astype(int)] if len(frames) else np.arange(_SHOWN)
    colours = colormaps["viridis"].with_extremes(bad="0.9")  # grey without pressure
    highest = max(float(found.pressure[shown].max()) / 1e6, 1e-6)
    cells = None
    for k, frame in enumerate(shown):
        axes: Axes = panels[f"map{k}"]
        cells = PolyCollection(list(corners[:, :, [across, up]]), cmap=colours, edgecolors="face", linewidths=0.2)
        pressure = found.pressure[frame] / 1e6
        cells.set(array=np.where(pressure > 0, pressure, np.nan), clim=(0, highest), rasterized=True)
        axes.add_collection(cells)
        place = 1e3 * found.center_on_patella[frame]
        axes.plot(place[across], place[up], marker="+", color="black", markersize=8)
        axes.autoscale_view()
        axes.set(aspect="equal", title=f"{found.times[frame]:.2f} s")
        _seen_from(outwards, axes, "patella", across, up, lateral)
        if k == 0:
            axes.set_ylabel(f"patella {_AXES[up]} [mm]")
    maps = [panels[f"map{k}"] for k in range(_SHOWN)]
    figure.colorbar(cells, ax=maps, label="pressure [MPa] (+: centre)", shrink=0.8, pad=0.01)


def _path(axes: Axes, found: ContactMap, femur: SurfaceMesh, lateral: Any) -> None:
    """Draws the centre of pressure on the femur seen from the loaded side: the mean force points to the viewer."""
    center = 1e3 * found.center_of_pressure[found.touching]
    towards = found.force[found.touching].sum(axis=0) if len(center) else np.array([0.0, 0.0, 1.0])
    across, up = _plane(towards)
    _surface(axes, femur, across, up, towards)
    times = found.times[found.touching]
    dots = axes.scatter(center[:, across], center[:, up], c=times, s=9, cmap="cividis", zorder=3)
    axes.plot(center[:, across], center[:, up], color="0.3", linewidth=0.6, zorder=2)
    axes.figure.colorbar(dots, ax=axes, label="time [s]", shrink=0.7)
    axes.set(title="Centre of pressure on the femur", ylabel=f"femur {_AXES[up]} [mm]", aspect="equal")
    _seen_from(towards, axes, "femur", across, up, lateral)


def _seen_from(towards: NDArray[np.float64], axes: Axes, body: str, across: int, up: int, lateral: Any) -> None:
    """Labels the horizontal axis, and inverts it if it runs to the left for a viewer on that side."""
    mirrored = bool(np.cross(*np.eye(3)[[across, up]]) @ towards < 0)
    if mirrored:
        axes.invert_xaxis()
    ends = ""  # second line of the label: which end is medial and which lateral, if known
    if lateral is not None and abs(lateral[across]) >= _NAMED:
        left, right = ("medial", "lateral") if (lateral[across] > 0) != mirrored else ("lateral", "medial")
        ends = f"\n{left} \N{LEFTWARDS ARROW}      \N{RIGHTWARDS ARROW} {right}"
    axes.set_xlabel(f"{body} {_AXES[across]} [mm]{ends}")


def _surface(axes: Axes, mesh: SurfaceMesh, across: int, up: int, towards: NDArray[np.float64]) -> None:
    """Draws the triangles that face the viewer, the nearest last, paler the more directly they face it."""
    from matplotlib.collections import PolyCollection

    view = np.zeros(3)
    depth = 3 - across - up
    view[depth] = np.sign(towards[depth]) or 1.0
    facing = mesh.area_vectors @ view / np.linalg.norm(mesh.area_vectors, axis=1)
    corners = 1e3 * mesh.vertices[mesh.faces]
    visible = np.flatnonzero(facing > 0)
    visible = visible[np.argsort(corners[visible].mean(axis=1) @ view)]
    greys = [str(g) for g in _DARKEST + (_PALEST - _DARKEST) * facing[visible]]
    flat = list(corners[visible][:, :, [across, up]])
    shaded = PolyCollection(flat, facecolors=greys, edgecolors=greys, linewidths=0.2)
    shaded.set(rasterized=True, zorder=1, label="femur")
    axes.add_collection(shaded)
    axes.autoscale_view()


def _courses(panels: dict[str, Any], found: ContactMap) -> None:
    force, area, pressure = panels["force"], panels["area"], panels["pressure"]
    t = found.times
    force.plot(t, np.linalg.norm(found.force, axis=1), color="black", label="size")
    for k, name in enumerate(_AXES):
        force.plot(t, found.force[:, k], color=COLOURS[k], label=name, linewidth=0.9)
    legend_above(force, ncols=4, title="Contact force on the patella, femur axes")
    force.set(ylabel="force [N]", xlabel="time [s]")
    area.plot(t, 1e6 * found.area, color=COLOURS[0])
    area.set(title="Contact area", ylabel="area [mm²]", xlabel="time [s]")
    pressure.plot(t, found.max_pressure / 1e6, color=COLOURS[1], label="maximum")
    pressure.plot(t, found.mean_pressure / 1e6, color=COLOURS[0], label="mean")
    legend_above(pressure, ncols=2, title="Pressure")
    pressure.set(ylabel="pressure [MPa]", xlabel="time [s]")


def _plane(normal: NDArray[np.float64]) -> list[int]:
    """The two axes most perpendicular to a direction, the horizontal one first."""
    return [k for k in (2, 0, 1) if k != int(np.argmax(np.abs(normal)))]


def dataset(found: ContactMap, button: SurfaceMesh, settings: dict[str, Any]) -> Dataset:
    """Returns the map and the button's mesh as a dataset in SI units, with vectors along the femur's axes."""
    from xarray import Dataset

    flags = {"flag_masks": np.array([1, 2], dtype=np.int32), "flag_meanings": "no_contact too_deep"}
    variables = {
        **{name: (over, getattr(found, name), about(*words)) for name, (over, *words) in annotated(ContactMap).items()},
        "status": (("time",), status(found), {**about("1", "reservations; 0: none"), **flags}),
        "vertex": (("vertex_number", "axis"), button.vertices, about("m", "button's vertices, patella frame")),
        "face": (("triangle", "corner"), button.faces, about("1", "vertices of the button's triangles")),
    }
    coordinates = {
        "time": (("time",), found.times, about("s", "time")),
        "axis": (("axis",), ["x", "y", "z"], about("1", "axes of the frame in question, as in the mesh's file")),
    }
    return Dataset(variables, coordinates, {"title": "contact at given poses", **settings})


def compressed(data: Dataset) -> dict[str, dict[str, Any]]:
    """Returns the NetCDF encoding that compresses the maps, most of whose values are empty."""
    return {name: {"zlib": True, "complevel": 4} for name in ("depth", "pressure") if name in data}
