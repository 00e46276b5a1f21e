"""Figures of a femoral mesh: its trochlear region, groove candidates and principal axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.results.plots.style import COLOURS, START, WIDE, house_style, legend_below

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.region import Candidate, PrincipalAxis, TrochlearRegion

_PANEL = 4.4  # height of a panel [in]


def plot_region(region: TrochlearRegion, mesh: SurfaceMesh, ax: Any = None) -> Any:
    """Plots a trochlear region on its mesh: the front view with the groove line, and the sagittal view.

    Given matplotlib axes, draws only the front view into them.
    """
    from matplotlib.figure import Figure

    with house_style():
        views = list(Figure(figsize=(WIDE, 5.4)).subplots(1, 2)) if ax is None else [ax]
        _draw_region(views, region, mesh)
        figure = views[0].figure
        if ax is None:
            legend_below(figure, *views[-1].get_legend_handles_labels())
    return figure


def _draw_region(views: list[Any], region: TrochlearRegion, mesh: SurfaceMesh) -> None:
    """Draws the front view, and the sagittal view if there is a second panel."""
    axes, origin = np.asarray(region.cylinder.axes.array()), np.asarray(region.cylinder.origin.array())
    points, groove = 1e3 * (mesh.vertices - origin) @ axes, 1e3 * (region.groove - origin) @ axes
    names = ("proximal [mm]", "lateral of the groove (right knee) [mm]", "anterior [mm]")
    for view, (i, j) in zip(views, ((1, 0), (2, 0)), strict=False):
        front = mesh.vertex_normals @ axes[:, 2] > -0.2
        view.scatter(*points[front & ~region.mask][:, [i, j]].T, s=0.5, c="0.75", label="mesh")
        heights = np.hypot(points[:, 0], points[:, 2])[region.mask]
        dots = view.scatter(*points[region.mask][:, [i, j]].T, s=1.5, c=heights, cmap="viridis", label="region")
        view.plot(groove[:, i], groove[:, j], color=COLOURS[1], marker=".", linewidth=1, label="groove line")
        view.set(xlabel=names[i], ylabel=names[j], aspect="equal")
        if (i, j) == (2, 0):
            view.plot(0, 0, **{**START, "marker": "+", "markersize": 12}, color="black", label="trochlear axis")
        else:
            view.figure.colorbar(dots, ax=view, label="distance from the axis [mm]")
    views[0].set_title(f"{region.source.rsplit('/', 1)[-1]}: {region.n_vertices} vertices")


def plot_grooves(candidates: Sequence[Candidate], mesh: SurfaceMesh) -> Figure:
    """Plots the region and groove line of each candidate in a separate front view, proximal upwards."""
    from matplotlib.figure import Figure

    columns = min(2, len(candidates))
    rows = -(-len(candidates) // columns)
    with house_style():
        figure = Figure(figsize=(WIDE * columns / 2, _PANEL * rows + 0.6))
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, candidate in zip(panels, candidates, strict=False):
            plot_region(candidate.region, mesh, ax)
            ax.set_title(f"anterior {candidate.anterior}, proximal {candidate.proximal}")
        for ax in panels[len(candidates) :]:
            ax.remove()
        legend_below(figure, *panels[0].get_legend_handles_labels())
    return figure


def plot_directions(candidates: Sequence[Candidate], axes: Sequence[PrincipalAxis], mesh: SurfaceMesh) -> Figure:
    """Plots the candidates or, if there are none, the principal axes."""
    return plot_grooves(candidates, mesh) if candidates else plot_principal(axes, mesh)


def plot_principal(axes: Sequence[PrincipalAxis], mesh: SurfaceMesh) -> Figure:
    """Plots three views, each along one principal direction, with lines along the axes of the mesh's frame."""
    from matplotlib.figure import Figure

    turn = np.stack([axis.direction for axis in axes], axis=1)
    points, normals = 1e3 * mesh.vertices @ turn, mesh.vertex_normals @ turn
    points -= 0.5 * (points.min(axis=0) + points.max(axis=0))
    with house_style():
        figure = Figure(figsize=(WIDE, _PANEL))
        for ax, (i, j, k) in zip(figure.subplots(1, 3), ((0, 1, 2), (1, 2, 0), (2, 0, 1)), strict=True):
            _draw_view(ax, points[normals[:, k] > 0], turn, (i, j, k))
    return figure


def _draw_view(ax: Any, points: Any, turn: Any, view: tuple[int, int, int]) -> None:
    """Draws the vertices that face the viewer, nearer ones darker."""
    i, j, k = view
    ax.scatter(points[:, i], points[:, j], s=1.0, c=points[:, k], cmap="Greys", rasterized=True)
    length = 0.8 * float(np.abs(points).max())
    for n, name in enumerate("xyz"):
        tip = length * turn[n, [i, j]]
        if np.linalg.norm(tip) < 0.15 * length:
            continue  # the axis points almost along the view
        ax.plot(*np.stack([0 * tip, 1.1 * tip], axis=1), color=COLOURS[n], linewidth=1.8)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        ax.text(*(1.1 * tip), f"+{name}", color=COLOURS[n], ha="center", va="center", fontweight="bold", bbox=box)
    names = [f"along ({', '.join(f'{v:.2f}' for v in np.round(turn[:, n], 2) + 0.0)}) [mm]" for n in (i, j)]
    ax.set(aspect="equal", xlabel=names[0], ylabel=names[1])
