"""Contour map of the trochlea in chart coordinates, with the paths of the button and its contacts."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.spatial import Rotation, Vec3
from pftwin.geometry.patch.charts import Chart, PlaneChart
from pftwin.geometry.patch.closest import Surface, rectangle_of
from pftwin.results.plots import style
from pftwin.results.plots.quantities import provenance
from pftwin.results.scene_geometry import indexed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result


MARGIN = 5.0  # of the map around the path [mm]
_SAMPLES = 121  # of a smooth surface, in each direction
_NAMES = (("distal", "proximal"), ("medial", "lateral"), ("posterior", "anterior"))
_LEVELS = 14
_POINTS = (
    ("point_medial", "contact, medial facet"),
    ("point_lateral", "contact, lateral facet"),
    ("center_of_pressure", "centre of pressure"),
)
_SCALE, _FRAME = 0.066, (1.9, 2.0)  # scale of a map [in per mm], and width and height of labels around it [in]
_SMALLEST, _LARGEST = (4.4, 4.2), (7.2, 8.5)


class Relief(NamedTuple):
    """Heights over (u, v) [mm], on a grid (triangles None) or at the vertices of a triangle mesh."""

    chart: Chart
    u: Floats
    v: Floats
    height: Floats
    triangles: NDArray[np.int64] | None
    rectangle: tuple[float, float, float, float] | None  # fitted range of a smooth surface: u, u, v, v [mm]

    @property
    def labels(self) -> tuple[str, str, str]:
        """Axis labels of u, v and height, with the positive directions of u and v."""
        along, across = _direction_label(self.chart.axes.ex), _direction_label(self.chart.axes.ey)
        flat = self.chart.axis_radius is None
        height = "height over the chart's plane" if flat else "distance from the trochlear axis"
        return f"along the groove, {along} [mm]", f"across the groove, {across} [mm]", f"{height} [mm]"

    @property
    def heights(self) -> tuple[float, float]:
        """Minimum and maximum height [mm]; for a fitted surface only within its rectangle, as it is steep outside."""
        inside = np.ones(self.height.shape, dtype=bool)
        if self.rectangle is not None:
            u0, u1, v0, v1 = self.rectangle
            inside = (self.u >= u0) & (self.u <= u1) & (self.v >= v0) & (self.v <= v1)
        return float(self.height[inside].min()), float(self.height[inside].max())

    def place(self, points: Floats) -> tuple[Floats, Floats]:
        """Projects points (n, 3) [m] of the femur frame to (u, v) [mm]; NaN stays NaN."""
        return _coordinates(self.chart, points)[:2]


def relief(result: Result, *paths: Floats) -> Relief:
    """Computes the height map of a result's trochlea around paths (n, 3) [m] in the femur frame.

    Raises:
        InputError: the scene has no contact between a button and a trochlea.
    """
    contact, surface = result.scene.contact, result.surface
    femur = None if contact is None else contact.femur_triangles()
    if femur is not None:
        mesh = indexed(femur)
        chart = _facing_plane(result, mesh) if surface is None else surface.chart
        return _of_mesh(chart, mesh, _window(chart, np.concatenate(paths)))
    if surface is None:
        raise InputError(
            "no contact between a button and a trochlea, so no surface to draw",
            where=result.scene_name,
            remedy="result.plot.against_flexion(), which needs none",
        )
    return _of_surface(surface, _window(surface.chart, np.concatenate(paths)))


def _of_surface(surface: Surface, window: Floats) -> Relief:
    """The map of a smooth surface over its rectangle, extended to cover the paths."""
    (u0, u1), (v0, v1) = 1e3 * np.array(rectangle_of(surface))
    window = np.stack([np.fmin(window[0], [u0, v0]), np.fmax(window[1], [u1, v1])])
    lines = [np.linspace(window[0, k], window[1, k], _SAMPLES) for k in (0, 1)]
    u, v = np.meshgrid(*lines, indexing="ij")
    height = _compiled(surface.height, *(jnp.asarray(1e-3 * a, float) for a in (u, v)))
    return Relief(surface.chart, u, v, 1e3 * np.asarray(height, dtype=np.float64), None, (u0, u1, v0, v1))


def _of_mesh(chart: Any, mesh: tuple[Floats, NDArray[np.int64]], window: Floats) -> Relief:
    """The map of a mesh: its triangles that face outwards and reach into the window, or all of these if none does."""
    u, v, height = _coordinates(chart, mesh[0])
    faces = mesh[1]
    fu, fv = u[faces], v[faces]
    area = (fu[:, 1] - fu[:, 0]) * (fv[:, 2] - fv[:, 0]) - (fu[:, 2] - fu[:, 0]) * (fv[:, 1] - fv[:, 0])
    reaches = np.ones(len(faces), dtype=bool)
    for c, (low, high) in zip((fu, fv), window.T, strict=True):
        reaches &= (c.max(axis=1) > low) & (c.min(axis=1) < high)
    outwards = area > 0
    drawn = faces[outwards & reaches if (outwards & reaches).any() else outwards]
    used, which = np.unique(drawn, return_inverse=True)
    return Relief(chart, u[used], v[used], height[used], which.reshape(-1, 3), None)


def _window(chart: Any, points: Floats) -> Floats:
    """Minimum and maximum (u, v) of the points, with a margin, (2, 2) [mm]."""
    u, v, _ = _coordinates(chart, points)
    return np.array([[np.nanmin(c) - MARGIN, np.nanmax(c) + MARGIN] for c in (u, v)]).T


def _facing_plane(result: Result, mesh: Any) -> PlaneChart:
    """A plane perpendicular to the mean contact force, for a mesh without a chart."""
    report = result.effects[str(result.contact)]
    force = np.stack([report[f"force_{k}"] for k in "xyz"], axis=1)
    out = np.nansum(force, axis=0)
    if not np.linalg.norm(out) > 0:
        raise InputError("the button touches nothing, so nothing says where to look", where=result.scene_name)
    z = out / np.linalg.norm(out)
    y = np.array([0.0, 1.0, 0.0]) - z[1] * z
    y /= np.linalg.norm(y)
    origin = Vec3.from_array(jnp.asarray(mesh[0].mean(axis=0)))
    return PlaneChart(origin, Rotation.from_array(jnp.asarray(np.stack([np.cross(y, z), y, z], axis=1))))


def _coordinates(chart: Any, points: Floats) -> tuple[Floats, Floats, Floats]:
    """(u, v, height) of points (n, 3) [m], in millimetres."""
    at = _compiled(chart.coordinates, Vec3(*(jnp.asarray(c, float) for c in points.T)))
    u, v, height = (1e3 * np.asarray(c, dtype=np.float64) for c in (at.x, at.y, at.z))
    return u, v, height


@eqx.filter_jit
def _compiled(method: Callable[..., Any], *given: Any) -> Any:
    return method(*given)


def _direction_label(axis: Vec3) -> str:
    """Anatomical name of the positive direction of an axis in the femur frame."""
    parts = [float(c) for c in (axis.x, axis.y, axis.z)]
    k = int(np.argmax(np.abs(parts)))
    return _NAMES[k][parts[k] > 0]


def trajectory(
    result: Result, *, measured: Measured | None = None, title: str | None = None, ax: Axes | None = None
) -> Figure:
    """Plots a contour map of the trochlea, seen from outside, with the paths of the button's centre and its contacts.

    Points are projected to the surface's chart, along and across the groove. A dot marks the start; a contact's path
    is broken where its facet carries no load. Dashed: the rectangle to which a surface patch was fitted.

    Args:
        result: result of a scene with contact.
        measured: measurements; the path of the centre is a wide grey line, labelled if it is synthetic.
        title: replaces the scene's name. Synthetic motion is labelled in any case.
        ax: axes to draw into; by default a new figure.

    Raises:
        InputError: the scene has no contact.
    """
    from matplotlib.figure import Figure

    report = result.effects.get(result.contact or "", {})
    contacts = {words: np.asarray(report[key]) for key, words in _POINTS if key in report}
    if len(contacts) > 2:  # both facets are drawn, so their centre of pressure adds nothing
        contacts.pop(_POINTS[-1][1])
    paths = [result.center, *contacts.values(), *([] if measured is None else [measured.center])]
    drawn = relief(result, *paths)
    with style.house_style(axes__grid=False):
        own = ax
        if own is None:
            figure = Figure(figsize=_size(drawn))
            own = figure.subplots()
            style.title(figure, title or result.scene_name)
            style.footer(figure, provenance(result))
        _map(own, drawn)
        if measured is not None:
            _line(own, drawn, measured.center, f"centre, {measured.label}", style.MEASURED)
        _line(own, drawn, result.center, "centre of the button", {"color": "black", "linewidth": 1.0, "zorder": 3})
        for i, (words, points) in enumerate(contacts.items()):
            look = {"color": style.COLOURS[i], "linestyle": style.DASHES[0], "linewidth": 1.2, "zorder": 4}
            _line(own, drawn, points, words, look)
        if ax is None:
            style.legend_below(figure, *own.get_legend_handles_labels(), most=2)
    return style.figure_of(own)


def _map(ax: Axes, drawn: Relief) -> None:
    """Draws the contours in light grey, so that the coloured paths stand out."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import MaxNLocator

    greys = ListedColormap([str(x) for x in np.linspace(0.72, 0.97, _LEVELS + 2)])
    levels = MaxNLocator(_LEVELS).tick_values(*drawn.heights)
    look: dict[str, Any] = {"levels": levels, "colors": "0.45", "linewidths": 0.4, "linestyles": "solid"}
    if drawn.triangles is None:
        filled = ax.contourf(drawn.v, drawn.u, drawn.height, levels=levels, cmap=greys, extend="both")
        lines = ax.contour(drawn.v, drawn.u, drawn.height, **look)
    else:
        mesh: Any = (drawn.v, drawn.u, drawn.triangles, drawn.height)
        filled = ax.tricontourf(*mesh, levels=levels, cmap=greys)
        lines = ax.tricontour(*mesh, **look)
    along, across, height = drawn.labels
    bar = ax.figure.colorbar(filled, ax=ax, label=height, shrink=0.8)
    bar.add_lines(lines)
    if drawn.rectangle is not None:
        u0, u1, v0, v1 = drawn.rectangle
        edge = {"fill": False, "linestyle": (0, (4, 3)), "edgecolor": "0.3", "linewidth": 0.8}
        ax.add_patch(Rectangle((v0, u0), v1 - v0, u1 - u0, label="edge of the fitted surface", **edge))
    ax.set(xlabel=across, ylabel=along, aspect="equal")


def _line(ax: Axes, drawn: Relief, points: np.ndarray, words: str, look: dict[str, Any]) -> None:
    u, v = drawn.place(points)
    ax.plot(v, u, label=words, **look)
    known = np.flatnonzero(np.isfinite(u))[:1]
    ax.plot(v[known], u[known], color=look["color"], zorder=look["zorder"], alpha=look.get("alpha", 1.0), **style.START)


def _size(drawn: Relief) -> tuple[float, float]:
    """Width and height of the figure [in], at the same scale for all maps that fit on a page."""
    wanted = (_SCALE * np.ptp(drawn.v) + _FRAME[0], _SCALE * np.ptp(drawn.u) + _FRAME[1])
    width, height = (float(np.clip(w, a, b)) for w, a, b in zip(wanted, _SMALLEST, _LARGEST, strict=True))
    return width, height
