"""Fit of a bicubic spline to a mesh's vertices: penalised least squares, with as many cells as the surface asks for.

Heights are fitted by least squares with a mild penalty on curvature (a thin plate's bending energy, after Eilers and
Marx's P-splines, Statistical Science 11 (1996) 89), which says what the spline is where there are no vertices: as
straight as its neighbourhood allows.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.errors import InputError, PftwinWarning
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
from pftwin.geometry.patch.spline import SplinePatch
from pftwin.geometry.patch.spline_basis import cell_of, cubic_basis

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from pftwin.geometry.patch.region import TrochlearRegion

TOLERANCE = 0.02e-3  # rms of the heights [m]
SMOOTHING = 0.25e-3  # waves of less than some 2 pi times this length are damped [m]
LONGEST_CELL, SHRINKING = 4e-3, 0.8  # the first attempt's cells [m], and how much shorter the next one's are
FEWEST_VERTICES = 16  # as many as the coefficients of a single cell


def fit_spline(
    surface: SurfaceMesh | ArrayLike,
    *,
    chart: Literal["plane", "cylinder"] | Chart = "plane",
    region: TrochlearRegion | ArrayLike | None = None,
    weights: Literal["vertex", "area"] = "vertex",
    emphasis: Emphasis | None = None,
    tolerance: float = TOLERANCE,
    smoothing: float = SMOOTHING,
) -> PatchFit:
    """Fit a spline to all selected vertices, with the longest cells of those tried that reach the tolerance.

    Warns where it is not reached before there are as many coefficients as vertices, and returns the best fit.

    Args:
        surface, chart, region, weights, emphasis: as for `pftwin.geometry.patch.polynomial_fit.fit_patch`.
        tolerance: rms of the heights that is asked for [m].
        smoothing: how strongly curvature is penalised, as a length [m]; details shorter than it are lost. Raise it for
            noisy scans.

    Raises:
        InputError: too few vertices, all of them on a line, values that are not finite, lengths that are not positive,
            or a surface folded over in this chart.
    """
    for name, length in (("tolerance", tolerance), ("smoothing", smoothing)):
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"found {length!r}", where=name, expected="a positive length in metres, e.g. 0.02e-3")
    points, normals, areas, where = surface_points(surface)
    mask, chart = selected_vertices(region, chart, len(points))
    weight = vertex_weights(points, areas, mask, weights, emphasis, where)
    selected = points[mask]
    if len(selected) < FEWEST_VERTICES:
        raise InputError(
            f"{len(selected)} vertices for a spline",
            where=where,
            expected=f"{FEWEST_VERTICES} or more",
            remedy="a finer mesh or a larger region",
        )
    u, v, h = chart_coordinates(chart, selected)
    if normals is not None:
        check_folds(chart, selected, normals[mask], where)
    center, half = _rectangle(u, v, where)
    a, b = (u - center[0]) / half[0], (v - center[1]) / half[1]
    coverage = covered(a, b, where, "spline")
    cells, coefficients = _refined(a, b, h, weight, half, tolerance, smoothing, where)
    patch = SplinePatch(
        chart, number(coefficients), (number(center[0]), number(center[1])), (number(half[0]), number(half[1]))
    )
    c, (n_u, n_v) = coefficients.ravel(), cells
    height, slope_a, slope_b = (_basis(a, b, cells, *orders) @ c for orders in ((0, 0), (1, 0), (0, 1)))
    return quality(
        patch, h, (height, slope_a * (0.5 * n_u / half[0]), slope_b * (0.5 * n_v / half[1])), weight, coverage
    )


def _rectangle(u: Points, v: Points, where: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Center and half size of the rectangle that holds all vertices: where there are none a spline goes on gently."""
    spread = np.linalg.svd(np.stack([u - u.mean(), v - v.mean()]), compute_uv=False)
    if not spread[1] > 1e-6 * spread[0]:
        raise InputError("all vertices lie on a line of the chart", where=where, remedy="a larger region")
    (low_u, high_u), (low_v, high_v) = ((float(c.min()), float(c.max())) for c in (u, v))
    return (0.5 * (high_u + low_u), 0.5 * (high_v + low_v)), (0.5 * (high_u - low_u), 0.5 * (high_v - low_v))


def _refined(
    a: Points,
    b: Points,
    h: Points,
    weight: Points,
    half: tuple[float, float],
    tolerance: float,
    smoothing: float,
    where: str,
) -> tuple[tuple[int, int], Points]:
    """Cells and coefficients of the coarsest attempt within the tolerance; else, with a warning, of the best."""
    best: tuple[float, tuple[int, int], Points] | None = None
    length, tried = LONGEST_CELL, None
    while True:
        cells = max(int(np.ceil(2 * half[0] / length)), 1), max(int(np.ceil(2 * half[1] / length)), 1)
        length *= SHRINKING
        if cells == tried:
            continue
        if best is not None and (cells[0] + 3) * (cells[1] + 3) > len(h):
            break
        tried, basis = cells, _basis(a, b, cells)
        c = _solved(basis, h, weight, cells, half, smoothing)
        rms = float(np.sqrt(np.average((h - basis @ c) ** 2, weights=weight)))
        if best is None or rms < best[0]:
            best = rms, cells, c.reshape(cells[0] + 3, cells[1] + 3)
        if rms <= tolerance:
            return cells, best[2]
    warnings.warn(
        f"{where}: the spline comes within {1e3 * best[0]:.3f} mm rms of the {len(h)} vertices, not within"
        f" {1e3 * tolerance:.3f} mm. Try a finer or less noisy mesh, a smaller region or a larger tolerance.",
        PftwinWarning,
        stacklevel=3,
    )
    return best[1], best[2]


def _basis(a: Points, b: Points, cells: tuple[int, int], along: int = 0, across: int = 0) -> csr_matrix:
    """(vertices, coefficients): the tensor-product basis, or a derivative of it by the cells' own coordinates."""
    from scipy.sparse import csr_matrix

    (i, x), (j, y) = (cell_of(c, n) for c, n in zip((a, b), cells, strict=True))
    four = np.arange(4)
    width = cells[1] + 3
    columns = (i[:, None, None] + four[:, None]) * width + j[:, None, None] + four
    values = np.stack(cubic_basis(x)[along], 1)[:, :, None] * np.stack(cubic_basis(y)[across], 1)[:, None, :]
    starts = 16 * np.arange(len(a) + 1)
    return csr_matrix((values.ravel(), columns.ravel(), starts), shape=(len(a), (cells[0] + 3) * width))


def _solved(
    basis: csr_matrix, h: Points, weight: Points, cells: tuple[int, int], half: tuple[float, float], smoothing: float
) -> Points:
    """The coefficients (n,) that make mean weighted squared error + smoothing^4 * mean squared curvature least."""
    from scipy.sparse import csc_array, diags_array, kron
    from scipy.sparse.linalg import spsolve

    def derivative(n: int, order: int, step: float) -> csc_array:
        """By differences of a row of n + 3 coefficients."""
        stencil = {0: [1.0], 1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}[order]
        rows = n + 3 - order
        return csc_array(diags_array(stencil, offsets=range(order + 1), shape=(rows, n + 3)) / step**order)

    (n_u, n_v), (step_u, step_v) = cells, (2 * half[0] / cells[0], 2 * half[1] / cells[1])
    system = (basis.T.multiply(weight / len(h)) @ basis).tocsc()
    for share, along, across in ((1.0, 2, 0), (2.0, 1, 1), (1.0, 0, 2)):
        bend = kron(derivative(n_u, along, step_u), derivative(n_v, across, step_v), format="csc")
        system = system + share * smoothing**4 / (n_u * n_v) * (bend.T @ bend)
    # Heights from their mean: what is solved for is of the size of the relief, not of the distance to the axis.
    level = np.average(h, weights=weight)
    return level + spsolve(system, basis.T @ (weight / len(h) * (h - level)))
