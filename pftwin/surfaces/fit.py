"""Least-squares fit of a polynomial patch to the vertices of a mesh: the paper's P2, P4, P5 and any other degree.

Michaud et al. 2024, section 2.4.2: heights of the vertices in the trochlear region, R^2 as the measure of the fit.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from pftwin.errors import InputError, PftwinWarning
from pftwin.leaves import number
from pftwin.surfaces.charts import Chart, CylindricalChart
from pftwin.surfaces.fit_input import (
    Emphasis,
    Points,
    chart_coordinates,
    check_folds,
    selected_vertices,
    surface_points,
    vertex_weights,
)
from pftwin.surfaces.mesh import SurfaceMesh
from pftwin.surfaces.patch import PolynomialPatch, exponents

if TYPE_CHECKING:
    from pftwin.surfaces.region import TrochlearRegion


@dataclass(frozen=True)
class PatchFit:
    """A fitted patch and how well it fits; lengths in metres.

    R^2 is 1 - sum w e^2 / sum w (h - mean h)^2 over the heights h, with the weights of the fit; rms likewise.
    """

    patch: PolynomialPatch
    r_squared: float
    rms: float  # of the height residuals
    max_error: float  # largest height residual
    rms_normal: float  # of the residuals along the patch's normal
    max_error_normal: float
    n_vertices: int
    coverage: float  # share of the patch's rectangle, in 8 x 8 cells, that holds vertices

    @property
    def name(self) -> str:
        """The paper's name of the polynomial, such as "P5"."""
        return f"P{self.patch.degree}"

    def __str__(self) -> str:
        return (
            f"{self.name}: R^2 {100 * self.r_squared:.2f} %, rms {1e3 * self.rms:.3f} mm, "
            f"max {1e3 * self.max_error:.3f} mm, {self.n_vertices} vertices"
        )


def parse_degree(name: str | int) -> int:
    """The degree of "P5" or 5.

    Raises:
        InputError: anything else, or a degree below 1 or above 12.
    """
    match = re.fullmatch(r"[Pp]?(\d{1,3})", str(name).strip())
    degree = int(match[1]) if match and not isinstance(name, bool) else 0
    if not 1 <= degree <= 12:
        raise InputError(f"no polynomial {name!r}", where="degree", expected='"P1" to "P12", or the number alone')
    return degree


def fit_patch(
    surface: SurfaceMesh | ArrayLike,
    *,
    degree: int | str = 5,
    chart: Literal["plane", "cylinder"] | Chart = "plane",
    region: TrochlearRegion | ArrayLike | None = None,
    weights: Literal["vertex", "area"] = "vertex",
    emphasis: Emphasis | None = None,
) -> PatchFit:
    """Fit a patch to a surface's vertices by weighted linear least squares on coordinates scaled to [-1, 1].

    Args:
        surface: a mesh, or vertices alone, (n, 3) [m].
        degree: total degree, "P5" or 5.
        chart: a chart, or which of the region's two.
        region: which vertices take part: a `TrochlearRegion` or a boolean mask (n,); all if None.
        weights: "vertex" counts every vertex alike, as the paper does; "area" by the area it stands for, so that a mesh
            refined in places gives the same patch as an even one.
        emphasis: further weights that refine part of the surface (where a patella dislocates, say): an array (n,), or a
            function of the points (k, 3) [m].

    Raises:
        InputError: fewer vertices than coefficients; vertices that do not determine the coefficients; values that are
            not finite; a surface folded over in this chart.
    """
    n = parse_degree(degree)
    points, normals, areas, where = surface_points(surface)
    mask, chart = selected_vertices(region, chart, len(points))
    weight = vertex_weights(points, areas, mask, weights, emphasis, where)
    selected = points[mask]
    need = len(exponents(n))
    if len(selected) < need:
        raise InputError(
            f"{len(selected)} vertices for the {need} coefficients of P{n}",
            where=where,
            remedy="a finer mesh, a larger region or a lower degree",
        )
    u, v, h = chart_coordinates(chart, selected)
    if normals is not None:
        check_folds(chart, selected, normals[mask], where)
    center, half = _domain(u, v, where)
    a, b = (u - center[0]) / half[0], (v - center[1]) / half[1]
    coefficients = _solve(_monomials(a, b, n), h, weight, n, where)
    patch = PolynomialPatch(
        chart,
        number(coefficients),
        (number(center[0]), number(center[1])),
        (number(half[0]), number(half[1])),
        n,
    )
    coverage = _coverage(a, b)
    if coverage < 0.75:
        warnings.warn(
            f"{where}: vertices cover {100 * coverage:.0f} % of the patch's rectangle; in the rest of it the polynomial"
            " is extrapolated. Try a smaller region.",
            PftwinWarning,
            stacklevel=2,
        )
    return _report(patch, coefficients, half, a, b, h, weight, coverage)


def _domain(u: Points, v: Points, where: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Center and half size of the patch's rectangle.

    Along v the vertices' range. Along u the median, over eight strips of v, of the strips' ranges, so that one corner
    that sticks out does not stretch the patch over places without vertices.
    """
    v_low, v_high = float(v.min()), float(v.max())
    strip = np.clip(((v - v_low) / max(v_high - v_low, 1e-300) * 8).astype(int), 0, 7)
    used = np.unique(strip)
    u_low = float(np.median([u[strip == k].min() for k in used]))
    u_high = float(np.median([u[strip == k].max() for k in used]))
    half = 0.5 * (u_high - u_low), 0.5 * (v_high - v_low)
    if not min(half) > 0:
        raise InputError("all vertices lie on a line of the chart", where=where, remedy="a larger region")
    return (0.5 * (u_high + u_low), 0.5 * (v_high + v_low)), half


def _monomials(a: Points, b: Points, degree: int) -> Points:
    """a^i b^j by columns, in the order of the patch's coefficients."""
    return np.stack([a**i * b**j for i, j in exponents(degree)], axis=1)


def _solve(basis: Points, h: Points, weight: Points, degree: int, where: str) -> Points:
    """Weighted least squares; refuses a rank-deficient system."""
    root = np.sqrt(weight)
    solution, _, rank, _ = np.linalg.lstsq(basis * root[:, None], h * root, rcond=1e-10)
    if rank < basis.shape[1]:
        raise InputError(
            f"the vertices determine only {rank} of the {basis.shape[1]} coefficients of P{degree}",
            where=where,
            remedy="vertices spread over the whole region (not along lines), or a lower degree",
        )
    return np.asarray(solution, dtype=np.float64)


def _coverage(a: Points, b: Points, cells: int = 8) -> float:
    """Share of the cells of the rectangle that hold a vertex, out of as many cells as the vertices could fill."""
    inside = (np.abs(a) <= 1) & (np.abs(b) <= 1)
    cells = int(np.clip(np.sqrt(inside.sum() / 8), 1, cells))
    i, j = (np.clip(((c[inside] + 1) / 2 * cells).astype(int), 0, cells - 1) for c in (a, b))
    return len(np.unique(i * cells + j)) / cells**2


def _report(
    patch: PolynomialPatch,
    coefficients: Points,
    half: tuple[float, float],
    a: Points,
    b: Points,
    h: Points,
    weight: Points,
    coverage: float,
) -> PatchFit:
    """Residuals in double precision."""
    powers = exponents(patch.degree)
    fitted = _monomials(a, b, patch.degree) @ coefficients
    slope_u = sum(c * i * a ** max(i - 1, 0) * b**j for c, (i, j) in zip(coefficients, powers, strict=True)) / half[0]
    slope_v = sum(c * j * a**i * b ** max(j - 1, 0) for c, (i, j) in zip(coefficients, powers, strict=True)) / half[1]
    if isinstance(patch.chart, CylindricalChart):
        slope_u = slope_u * float(patch.chart.radius) / fitted
    error = h - fitted
    normal = error / np.sqrt(1 + slope_u**2 + slope_v**2)
    spread = np.average((h - np.average(h, weights=weight)) ** 2, weights=weight)
    unexplained = np.average(error**2, weights=weight)
    return PatchFit(
        patch=patch,
        r_squared=float(1 - unexplained / spread) if spread > 1e-24 else 1.0,
        rms=float(np.sqrt(unexplained)),
        max_error=float(np.abs(error).max()),
        rms_normal=float(np.sqrt(np.average(normal**2, weights=weight))),
        max_error_normal=float(np.abs(normal).max()),
        n_vertices=len(h),
        coverage=coverage,
    )
