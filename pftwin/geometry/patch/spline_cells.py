"""Fits a spline's cells and coefficients to vertices, by penalised least squares on successively shorter cells.

For the penalty on curvature see `pftwin.geometry.patch.fit`. Runs on the host.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.geometry.patch.fit_vertices import Vertices
from pftwin.geometry.patch.spline import cell_of, cubic_basis

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_matrix

Pair = tuple[float, float]
LONGEST_CELL, SHRINKING = 4e-3, 0.8  # length of the cells in the first attempt [m], and factor for each further one
FEWEST_VERTICES = 16  # the number of coefficients of a single cell


@dataclass(frozen=True, eq=False)
class FittedSpline:
    """A spline on a rectangle and the vertices that it was fitted to."""

    vertices: Vertices
    center: Pair  # of the rectangle [m]
    half: Pair
    a: Floats  # the vertices' coordinates in it along u, -1 to 1, (n,)
    b: Floats  # and along v
    cells: tuple[int, int]
    coefficients: Floats  # (n_u + 3, n_v + 3) [m]
    rms: float  # of the height residuals [m]

    def values(self) -> tuple[Floats, Floats, Floats]:
        """Heights at the vertices [m] and slopes along u and v [-], (n,) each."""
        (n_u, n_v), c = self.cells, self.coefficients.ravel()
        height, slope_a, slope_b = (
            _basis(self.a, self.b, self.cells, *orders) @ c for orders in ((0, 0), (1, 0), (0, 1))
        )
        return height, slope_a * (0.5 * n_u / self.half[0]), slope_b * (0.5 * n_v / self.half[1])


def refined_spline(v: Vertices, tolerance: float, smoothing: float) -> FittedSpline:
    """Fits the spline with the longest cells (among those tried) that reach the tolerance [m]; else the best one.

    Raises InputError for too few vertices, or all of them on a line.
    """
    if len(v.h) < FEWEST_VERTICES:
        raise InputError(
            f"{len(v.h)} vertices for a spline",
            where=v.source,
            expected=f"{FEWEST_VERTICES} or more",
            remedy="a finer mesh or a larger region",
        )
    center, half = _rectangle(v)
    a, b = (v.u - center[0]) / half[0], (v.v - center[1]) / half[1]
    best: FittedSpline | None = None
    length, tried = LONGEST_CELL, None
    while True:
        cells = max(int(np.ceil(2 * half[0] / length)), 1), max(int(np.ceil(2 * half[1] / length)), 1)
        length *= SHRINKING
        if cells == tried:
            continue
        if best is not None and (cells[0] + 3) * (cells[1] + 3) > len(v.h):
            return best
        tried, basis = cells, _basis(a, b, cells)
        c = _solved(basis, v, cells, half, smoothing)
        rms = float(np.sqrt(np.average((v.h - basis @ c) ** 2, weights=v.weight)))
        if best is None or rms < best.rms:
            best = FittedSpline(v, center, half, a, b, cells, c.reshape(cells[0] + 3, cells[1] + 3), rms)
        if rms <= tolerance:
            return best


def _rectangle(v: Vertices) -> tuple[Pair, Pair]:
    """Centre and half size of the rectangle that contains all vertices."""
    singular_values = np.linalg.svd(np.stack([v.u - v.u.mean(), v.v - v.v.mean()]), compute_uv=False)
    if not singular_values[1] > 1e-6 * singular_values[0]:
        raise InputError("all vertices lie on a line of the chart", where=v.source, remedy="a larger region")
    (low_u, high_u), (low_v, high_v) = ((float(c.min()), float(c.max())) for c in (v.u, v.v))
    return (0.5 * (high_u + low_u), 0.5 * (high_v + low_v)), (0.5 * (high_u - low_u), 0.5 * (high_v - low_v))


def _basis(a: Floats, b: Floats, cells: tuple[int, int], along: int = 0, across: int = 0) -> csr_matrix:
    """Tensor-product basis (vertices, coefficients), or a derivative of it by the cells' coordinates."""
    from scipy.sparse import csr_matrix

    (i, x), (j, y) = (cell_of(c, n) for c, n in zip((a, b), cells, strict=True))
    four = np.arange(4)
    width = cells[1] + 3
    columns = (i[:, None, None] + four[:, None]) * width + j[:, None, None] + four
    values = np.stack(cubic_basis(x)[along], 1)[:, :, None] * np.stack(cubic_basis(y)[across], 1)[:, None, :]
    starts = 16 * np.arange(len(a) + 1)
    return csr_matrix((values.ravel(), columns.ravel(), starts), shape=(len(a), (cells[0] + 3) * width))


def _solved(basis: csr_matrix, v: Vertices, cells: tuple[int, int], half: Pair, smoothing: float) -> Floats:
    """Coefficients (n,) that minimize mean weighted squared error + smoothing^4 * mean squared curvature."""
    from scipy.sparse import csc_array, diags_array, kron
    from scipy.sparse.linalg import spsolve

    def derivative(n: int, order: int, step: float) -> csc_array:
        """Derivative of a given order as differences of n + 3 coefficients."""
        stencil = {0: [1.0], 1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}[order]
        rows = n + 3 - order
        return csc_array(diags_array(stencil, offsets=range(order + 1), shape=(rows, n + 3)) / step**order)

    (n_u, n_v), (step_u, step_v) = cells, (2 * half[0] / cells[0], 2 * half[1] / cells[1])
    system = (basis.T.multiply(v.weight / len(v.h)) @ basis).tocsc()
    for share, along, across in ((1.0, 2, 0), (2.0, 1, 1), (1.0, 0, 2)):
        bend = kron(derivative(n_u, along, step_u), derivative(n_v, across, step_v), format="csc")
        system = system + share * smoothing**4 / (n_u * n_v) * (bend.T @ bend)
    # Subtract the mean, so that the solution has the size of the relief, not of the distance to the axis.
    level = np.average(v.h, weights=v.weight)
    return level + spsolve(system, basis.T @ (v.weight / len(v.h) * (v.h - level)))
