"""What a fit starts from: which vertices, in which chart, with which weights, and whether they can be fitted at all."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart, CylindricalChart, PlaneChart

if TYPE_CHECKING:
    from pftwin.geometry.patch.region import TrochlearRegion

Points = NDArray[np.float64]
Emphasis = ArrayLike | Callable[[Points], ArrayLike]


def surface_points(surface: SurfaceMesh | ArrayLike) -> tuple[Points, Points | None, Points | None, str]:
    """Vertices, normals, areas and a name for messages; normals and areas where the surface is a mesh."""
    if isinstance(surface, SurfaceMesh):
        return surface.vertices, surface.vertex_normals, surface.vertex_areas, surface.source
    points = np.asarray(surface, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"vertices of shape {points.shape}", where="surface", expected="(n, 3)")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{bad.size} vertices are not finite, the first is number {bad[0]}", where="surface")
    return points, None, None, "surface"


def selected_vertices(
    region: TrochlearRegion | ArrayLike | None, chart: str | Chart, n: int
) -> tuple[NDArray[np.bool_], Chart]:
    """The vertices that take part and the chart itself."""
    from pftwin.geometry.patch.region import TrochlearRegion

    if isinstance(chart, str):
        if chart not in ("plane", "cylinder"):
            raise InputError(f"no chart {chart!r}", where="chart", expected='"plane", "cylinder" or a chart')
        if not isinstance(region, TrochlearRegion):
            raise InputError(
                f"chart={chart!r} has no place of its own",
                where="chart",
                remedy="pass region=trochlear_region(mesh, ...), or a PlaneChart or CylindricalChart",
            )
        chart = region.plane if chart == "plane" else region.cylinder
    mask = np.ones(n, dtype=bool) if region is None else np.asarray(getattr(region, "mask", region))
    if mask.shape != (n,) or mask.dtype != bool:
        raise InputError(
            f"a mask of {mask.dtype} and shape {mask.shape} for {n} vertices",
            where="region",
            expected=f"bool, ({n},), made from this very mesh",
        )
    return mask, chart


def vertex_weights(
    points: Points,
    areas: Points | None,
    mask: NDArray[np.bool_],
    weights: str,
    emphasis: Emphasis | None,
    where: str,
) -> Points:
    """One non-negative weight for each selected vertex, with mean 1."""
    if weights not in ("vertex", "area"):
        raise InputError(f"no weights {weights!r}", where="weights", expected='"vertex" or "area"')
    if weights == "area" and areas is None:
        raise InputError("vertices alone have no areas", where="weights", remedy='pass a mesh, or weights="vertex"')
    w = np.ones(int(mask.sum())) if weights == "vertex" or areas is None else areas[mask]
    if emphasis is not None:
        extra = np.asarray(emphasis(points[mask]) if callable(emphasis) else emphasis, dtype=np.float64)
        if extra.shape == mask.shape and not callable(emphasis):
            extra = extra[mask]
        if extra.shape != w.shape or not np.isfinite(extra).all() or (extra < 0).any():
            raise InputError(
                f"weights of shape {extra.shape}, smallest {np.min(extra, initial=np.inf):g}",
                where="emphasis",
                expected=f"{len(w)} finite values, none negative",
            )
        w = w * extra
    if w.size and not w.sum() > 0:
        raise InputError("all weights are zero", where=where)
    return w / w.mean() if w.size else w


def as_vector(v: object) -> Points:
    """A Vec3 as an array in double precision, whatever JAX's default is."""
    return np.array([np.asarray(getattr(v, k), dtype=np.float64) for k in "xyz"])


def in_frame(chart: Chart, points: Points) -> Points:
    """Coordinates in the chart's frame, in double precision."""
    axes = np.stack([as_vector(chart.axes.ex), as_vector(chart.axes.ey), as_vector(chart.axes.ez)], axis=1)
    return (points - as_vector(chart.origin)) @ axes


def chart_coordinates(chart: Chart, points: Points) -> tuple[Points, Points, Points]:
    """u, v and height of points of the femur frame."""
    x, y, z = in_frame(chart, points).T
    if isinstance(chart, PlaneChart):
        return x, y, z
    return float(chart.radius) * np.arctan2(x, z), y, np.hypot(x, z)


def check_folds(chart: Chart, points: Points, normals: Points, where: str) -> None:
    """Normals that point away from the chart's height mean more than one height for one (u, v)."""
    origin = as_vector(chart.origin)
    local = in_frame(chart, normals + origin)
    if isinstance(chart, CylindricalChart):
        x, _, z = in_frame(chart, points).T
        up = (local[:, 0] * x + local[:, 2] * z) / np.hypot(x, z)
    else:
        up = local[:, 2]
    folded = float(np.mean(up <= 0))
    if folded == 0:
        return
    if folded > 0.9:
        raise InputError(
            f"the normals of {100 * folded:.0f} % of the vertices point into the bone",
            where=where,
            remedy="mesh.flipped(), or a chart that looks the other way",
        )
    text = f"{100 * folded:.1f} % of the vertices face away from the chart: the surface folds over in it"
    remedy = 'a chart="cylinder", a chart tilted to the middle of the arc, or a region of fewer degrees'
    if folded > 0.01:
        raise InputError(text, where=where, remedy=remedy)
    warnings.warn(f"{where}: {text}; try: {remedy}", PftwinWarning, stacklevel=3)
