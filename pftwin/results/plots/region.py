"""Figures of the trochlear region that was found on a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.results.plots.style import COLOURS, START, WIDE, house_style, legend_below

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.region import TrochlearRegion


def plot_region(region: TrochlearRegion, mesh: SurfaceMesh, ax: Any = None) -> Any:
    """Draw a region for inspection: front view with the groove line, and, without `ax`, the sagittal view beside it.

    Args:
        region, mesh: as found, and the mesh it was found on.
        ax: matplotlib axes for the front view alone; a new figure with both views if None.

    Returns:
        The figure.
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
    """The front view, and the sagittal one where there is room for it."""
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
