"""The patella's path over the trochlea: contours of the surface, the button's centre, and where each facet bears."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.results.plots.panels import figure_of
from pftwin.results.plots.quantities import provenance
from pftwin.results.plots.relief import Relief, relief
from pftwin.results.plots.style import COLOURS, DASHES, MEASURED, START, house_style, legend_below
from pftwin.results.plots.style import title as name_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result

_LEVELS = 14
_POINTS = (
    ("point_medial", "contact, medial facet"),
    ("point_lateral", "contact, lateral facet"),
    ("center_of_pressure", "centre of pressure"),
)
_SCALE, _FRAME = 0.066, (1.9, 2.0)  # of a map [in per mm], and what stands around it [in]
_SMALLEST, _LARGEST = (4.4, 4.2), (7.2, 8.5)


def trajectory(
    result: Result, *, measured: Measured | None = None, title: str | None = None, ax: Axes | None = None
) -> Figure:
    """The trochlea as a map, seen from outside: contours, the path of the button's centre, and the contact paths.

    Places are those straight below a point in the surface's chart: along the groove, and across it. A dot is the start;
    a contact's path is broken where its facet bears nothing. Dashed: the rectangle to which a patch was fitted.

    Args:
        result: of a scene with contact.
        measured: the centre's measured path, wide grey; labelled synthetic where it is.
        title: in the place of the scene's name. That a motion is synthetic is said in any case.
        ax: axes to draw into; by default a new figure.

    Raises:
        InputError: a scene without contact.
    """
    from matplotlib.figure import Figure

    report = result.effects.get(result.contact or "", {})
    contacts = {words: np.asarray(report[key]) for key, words in _POINTS if key in report}
    if len(contacts) > 2:  # facets say more than the centre of both
        contacts.pop(_POINTS[-1][1])
    paths = [result.center, *contacts.values(), *([] if measured is None else [measured.center])]
    drawn = relief(result, *paths)
    with house_style(axes__grid=False):
        own = ax
        if own is None:
            figure = Figure(figsize=_size(drawn))
            own = figure.subplots()
            name_figure(figure, title or result.scene_name, provenance(result))
        _map(own, drawn)
        if measured is not None:
            _line(own, drawn, measured.center, f"centre, {measured.label}", MEASURED)
        _line(own, drawn, result.center, "centre of the button", {"color": "black", "linewidth": 1.0, "zorder": 3})
        for i, (words, points) in enumerate(contacts.items()):
            look = {"color": COLOURS[i], "linestyle": DASHES[0], "linewidth": 1.2, "zorder": 4}
            _line(own, drawn, points, words, look)
        if ax is None:
            legend_below(figure, *own.get_legend_handles_labels(), most=2)
    return figure_of(own)


def _map(ax: Axes, drawn: Relief) -> None:
    """Light greys, so that the paths keep the colours."""
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
    ax.plot(v[known], u[known], color=look["color"], zorder=look["zorder"], alpha=look.get("alpha", 1.0), **START)


def _size(drawn: Relief) -> tuple[float, float]:
    """Of the figure [in]: a map of the same scale wherever it fits on a page."""
    wanted = (_SCALE * np.ptp(drawn.v) + _FRAME[0], _SCALE * np.ptp(drawn.u) + _FRAME[1])
    width, height = (float(np.clip(w, a, b)) for w, a, b in zip(wanted, _SMALLEST, _LARGEST, strict=True))
    return width, height
