"""The vertices that a patch is fitted to, with their chart and weights, and the quality of the fit."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.leaves import host_array
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart, CylindricalChart, PlaneChart
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.geometry.patch.region import TrochlearRegion
from pftwin.geometry.patch.spline import SplinePatch

Emphasis = ArrayLike | Callable[[Floats], ArrayLike]
ENOUGH = 0.75  # coverage below which a fit warns


@dataclass(frozen=True, eq=False)
class Vertices:
    """The vertices of a fit, in double precision, (n,) each."""

    chart: Chart
    points: Floats  # (n, 3) [m]
    normals: Floats | None  # (n, 3), if the surface is a mesh
    u: Floats  # chart coordinates [m]
    v: Floats
    h: Floats
    weight: Floats  # mean 1
    source: str  # name for messages

    def folded(self) -> float:
        """Share of normals that point against the chart's height direction: there the surface folds over in (u, v)."""
        if self.normals is None:
            return 0.0
        local = _in_frame(self.chart, self.normals + host_array(self.chart.origin))
        if isinstance(self.chart, CylindricalChart):
            x, _, z = _in_frame(self.chart, self.points).T
            up = (local[:, 0] * x + local[:, 2] * z) / np.hypot(x, z)
        else:
            up = local[:, 2]
        return float(np.mean(up <= 0))

    def check_folds(self) -> None:
        """Raises InputError if more than 1 % of the surface folds over, and warns of less."""
        folded = self.folded()
        if folded == 0:
            return
        if folded > 0.9:
            found = f"the normals of {100 * folded:.0f} % of the vertices point into the bone"
            raise InputError(found, where=self.source, remedy="mesh.flipped(), or a chart that looks the other way")
        text = f"{100 * folded:.1f} % of the vertices face away from the chart: the surface folds over in it"
        remedy = 'a chart="cylinder", a chart tilted to the middle of the arc, or a region of fewer degrees'
        if folded > 0.01:
            raise InputError(text, where=self.source, remedy=remedy)
        warnings.warn(f"{self.source}: {text}; try: {remedy}", PftwinWarning, stacklevel=3)


def selected_vertices(
    surface: SurfaceMesh | ArrayLike,
    chart: str | Chart,
    region: TrochlearRegion | ArrayLike | None,
    weights: str,
    emphasis: Emphasis | None,
) -> Vertices:
    """Selects the vertices of a fit; arguments and errors as in `fit_patch`."""
    points, normals, areas, source = _of_surface(surface)
    n = len(points)
    if isinstance(chart, str):
        if chart not in ("plane", "cylinder"):
            raise InputError(f"no chart {chart!r}", where="chart", expected='"plane", "cylinder" or a chart')
        if not isinstance(region, TrochlearRegion):
            raise InputError(
                f"chart={chart!r} has no position without a region",
                where="chart",
                remedy="pass region=trochlear_region(mesh, ...), or a PlaneChart or CylindricalChart",
            )
        chart = region.plane if chart == "plane" else region.cylinder
    mask = np.ones(n, dtype=bool) if region is None else np.asarray(getattr(region, "mask", region))
    if mask.shape != (n,) or mask.dtype != bool:
        found = f"a mask of {mask.dtype} and shape {mask.shape} for {n} vertices"
        raise InputError(found, where="region", expected=f"bool, ({n},), made from this very mesh")
    weight = _weights(points, areas, mask, weights, emphasis, source)
    used = points[mask]
    return Vertices(
        chart, used, None if normals is None else normals[mask], *chart_coordinates(chart, used), weight, source
    )


def _of_surface(surface: SurfaceMesh | ArrayLike) -> tuple[Floats, Floats | None, Floats | None, str]:
    """Vertices, normals, areas and a name for messages; normals and areas are None unless the surface is a mesh."""
    if isinstance(surface, SurfaceMesh):
        return surface.vertices, surface.vertex_normals, surface.vertex_areas, surface.source
    points = np.asarray(surface, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"vertices of shape {points.shape}", where="surface", expected="(n, 3)")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{bad.size} vertices are not finite, the first is number {bad[0]}", where="surface")
    return points, None, None, "surface"


def _weights(
    points: Floats,
    areas: Floats | None,
    mask: NDArray[np.bool_],
    weights: str,
    emphasis: Emphasis | None,
    where: str,
) -> Floats:
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
            found = f"weights of shape {extra.shape}, smallest {np.min(extra, initial=np.inf):g}"
            raise InputError(found, where="emphasis", expected=f"{len(w)} finite values, none negative")
        w = w * extra
    if w.size and not w.sum() > 0:
        raise InputError("all weights are zero", where=where)
    return w / w.mean() if w.size else w


def _in_frame(chart: Chart, points: Floats) -> Floats:
    """Coordinates in the chart's frame, in double precision."""
    return (points - host_array(chart.origin)) @ host_array(chart.axes)


def chart_coordinates(chart: Chart, points: Floats) -> tuple[Floats, Floats, Floats]:
    """u, v and height (n,) of points (n, 3) of the femur's frame [m]."""
    x, y, z = _in_frame(chart, points).T
    if isinstance(chart, PlaneChart):
        return x, y, z
    return float(chart.radius) * np.arctan2(x, z), y, np.hypot(x, z)


@dataclass(frozen=True)
class PatchFit:
    """A fitted patch and the quality of its fit; lengths in metres.

    R^2 is 1 - sum w e^2 / sum w (h - mean h)^2 for heights h, residuals e and the fit's weights w; rms is weighted too.
    """

    patch: PolynomialPatch | SplinePatch
    r_squared: float
    rms: float  # of the height residuals
    max_error: float  # largest height residual
    rms_normal: float  # of the residuals along the patch's normal
    max_error_normal: float
    n_vertices: int
    coverage: float  # share of 8 x 8 cells of the patch's rectangle that contain vertices
    chart_chosen: str = ""  # if the fit chose a chart other than the plane: which one, and why

    @property
    def name(self) -> str:
        """Name of the polynomial in the paper, such as "P5"; or "spline"."""
        return self.patch.name

    def __str__(self) -> str:
        cells = "" if isinstance(self.patch, PolynomialPatch) else " of {} x {} cells".format(*self.patch.cells)
        chosen = f", {self.chart_chosen}" if self.chart_chosen else ""
        return (
            f"{self.name}{cells}: R^2 {100 * self.r_squared:.2f} %, rms {1e3 * self.rms:.3f} mm, "
            f"max {1e3 * self.max_error:.3f} mm, {self.n_vertices} vertices{chosen}"
        )


def quality(
    patch: PolynomialPatch | SplinePatch, v: Vertices, fitted: tuple[Floats, Floats, Floats], a: Floats, b: Floats
) -> PatchFit:
    """Evaluates the quality of a fit, in double precision.

    `fitted` holds the patch's heights at the vertices [m] and its slopes along u and v [-], (n,) each; a, b are the
    vertices' coordinates in the patch's rectangle, -1 to 1, (n,).
    """
    height, slope_u, slope_v = fitted
    if isinstance(patch.chart, CylindricalChart):
        slope_u = slope_u * float(patch.chart.radius) / height
    error, weight = v.h - height, v.weight
    normal = error / np.sqrt(1 + slope_u**2 + slope_v**2)
    variance = np.average((v.h - np.average(v.h, weights=weight)) ** 2, weights=weight)
    unexplained = np.average(error**2, weights=weight)
    return PatchFit(
        patch=patch,
        r_squared=float(1 - unexplained / variance) if variance > 1e-24 else 1.0,
        rms=float(np.sqrt(unexplained)),
        max_error=float(np.abs(error).max()),
        rms_normal=float(np.sqrt(np.average(normal**2, weights=weight))),
        max_error_normal=float(np.abs(normal).max()),
        n_vertices=len(v.h),
        coverage=_covered(a, b, v.source, "spline" if patch.name == "spline" else "polynomial"),
    )


def _covered(a: Floats, b: Floats, where: str, kind: str, cells: int = 8) -> float:
    """Number of the rectangle's cells with a vertex, as a share of all cells, or of the vertices if these are fewer.

    Warns if it is small. `kind` is the patch's name in the message.
    """
    inside = (np.abs(a) <= 1) & (np.abs(b) <= 1)
    cells = int(np.clip(np.sqrt(inside.sum() / 8), 1, cells))
    i, j = (np.clip(((c[inside] + 1) / 2 * cells).astype(int), 0, cells - 1) for c in (a, b))
    share = len(np.unique(i * cells + j)) / cells**2
    if share < ENOUGH:
        warnings.warn(
            f"{where}: vertices cover {100 * share:.0f} % of the patch's rectangle; in the rest of it the {kind}"
            " is extrapolated. Try a smaller region.",
            PftwinWarning,
            stacklevel=4,
        )
    return share
