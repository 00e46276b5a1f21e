"""Least-squares fit of a polynomial patch to the vertices of a mesh: the paper's P2, P4, P5 and any other degree.

Michaud et al. 2024, section 2.4.2: heights of the vertices in the trochlear region, R^2 as the measure of the fit.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.errors import InputError
from pftwin.base.leaves import number
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart
from pftwin.geometry.patch.fit_input import (
    Emphasis,
    Points,
    chart_coordinates,
    check_folds,
    selected_vertices,
    surface_points,
    vertex_weights,
)
from pftwin.geometry.patch.fit_quality import PatchFit, covered, quality
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents

if TYPE_CHECKING:
    from pftwin.geometry.patch.region import TrochlearRegion


def parse_degree(name: str | int, *, others: str = "") -> int:
    """The degree of "P5" or 5. `others`: what else the user could have said, for the message.

    Raises:
        InputError: anything else, or a degree below 1 or above 12.
    """
    match = re.fullmatch(r"[Pp]?(\d{1,3})", str(name).strip())
    degree = int(match[1]) if match and not isinstance(name, bool) else 0
    if not 1 <= degree <= 12:
        or_else = f', or "{others}"' if others else ""
        expected = f'"P1" to "P12", or the number alone{or_else}'
        raise InputError(f"no polynomial {name!r}", where="degree", expected=expected)
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
    coverage = covered(a, b, where, "polynomial")
    return quality(patch, h, _heights_and_slopes(coefficients, n, half, a, b), weight, coverage)


def _heights_and_slopes(
    coefficients: Points, degree: int, half: tuple[float, float], a: Points, b: Points
) -> tuple[Points, Points, Points]:
    """The polynomial at the vertices, in double precision."""
    slope_u, slope_v = np.zeros_like(a), np.zeros_like(b)
    for c, (i, j) in zip(coefficients, exponents(degree), strict=True):
        slope_u += c * i * a ** max(i - 1, 0) * b**j / half[0]
        slope_v += c * j * a**i * b ** max(j - 1, 0) / half[1]
    return _monomials(a, b, degree) @ coefficients, slope_u, slope_v


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
