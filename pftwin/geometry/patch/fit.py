"""Fits of a patch to the vertices of a mesh: a polynomial of any degree (the paper's P2, P4, P5), or a spline.

Michaud et al. 2024, section 2.4.2: heights of the vertices in the trochlear region, R^2 as the measure of the fit. A
spline has as many cells as the surface asks for and a mild penalty on curvature (a thin plate's bending energy, after
Eilers and Marx's P-splines, Statistical Science 11 (1996) 89), which says what it is where there are no vertices.
"""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.leaves import number
from pftwin.base.spatial import Scalar
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart
from pftwin.geometry.patch.fit_vertices import Emphasis, PatchFit, Points, Vertices, quality, selected_vertices
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.geometry.patch.spline import SplinePatch, cell_of, cubic_basis

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_matrix

    from pftwin.geometry.patch.region import TrochlearRegion

Pair = tuple[float, float]
SPLINE = "spline"
TOLERANCE = 0.02e-3  # rms of the heights [m]
SMOOTHING = 12.5  # tolerances: a length, wavelengths below some 2 pi times which are damped
LONGEST_CELL, SHRINKING = 4e-3, 0.8  # the first attempt's cells [m], and how much shorter the next one's are
FEWEST_VERTICES = 16  # as many as the coefficients of a single cell


def parse_degree(name: str | int, *, others: str = "") -> int:
    """The degree of "P5" or 5. `others`: other accepted words, for the message.

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


def parse_name(name: str | int) -> str:
    """ "P5" for "p5", "5" or 5, and "spline" for "Spline".

    Raises:
        InputError: anything else, or a degree below 1 or above 12.
    """
    if isinstance(name, str) and name.strip().lower() == SPLINE:
        return SPLINE
    return f"P{parse_degree(name, others=SPLINE)}"


def name_of(surface: Any) -> str | None:
    """The name of a patch; None for a surface of another kind."""
    return surface.name if isinstance(surface, (PolynomialPatch, SplinePatch)) else None


def fit_named(surface: SurfaceMesh | ArrayLike, name: str | int, **options: Any) -> PatchFit:
    """The patch of that name, fitted to a surface; options as for `fit_patch`, or `fit_spline` for "spline".

    Raises:
        InputError: no such name; otherwise as the two.
    """
    name = parse_name(name)
    return fit_spline(surface, **options) if name == SPLINE else fit_patch(surface, degree=name, **options)


def fit_patch(
    surface: SurfaceMesh | ArrayLike,
    *,
    degree: int | str = 5,
    chart: Literal["plane", "cylinder"] | Chart = "plane",
    region: TrochlearRegion | ArrayLike | None = None,
    weights: Literal["vertex", "area"] = "vertex",
    emphasis: Emphasis | None = None,
) -> PatchFit:
    """Fit a polynomial to a surface's vertices by weighted linear least squares on coordinates scaled to [-1, 1].

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
    need = len(exponents(n))
    v = selected_vertices(surface, chart, region, weights, emphasis)
    if len(v.h) < need:
        raise InputError(
            f"{len(v.h)} vertices for the {need} coefficients of P{n}",
            where=v.source,
            remedy="a finer mesh, a larger region or a lower degree",
        )
    v.check_folds()
    center, half = _domain(v)
    a, b = (v.u - center[0]) / half[0], (v.v - center[1]) / half[1]
    basis = _monomials(a, b, n)
    root = np.sqrt(v.weight)
    c, _, rank, _ = np.linalg.lstsq(basis * root[:, None], v.h * root, rcond=1e-10)
    if rank < need:
        raise InputError(
            f"the vertices determine only {rank} of the {need} coefficients of P{n}",
            where=v.source,
            remedy="vertices spread over the whole region (not along lines), or a lower degree",
        )
    slope_u, slope_v = np.zeros_like(a), np.zeros_like(b)
    for x, (i, j) in zip(c, exponents(n), strict=True):
        slope_u += x * i * a ** max(i - 1, 0) * b**j / half[0]
        slope_v += x * j * a**i * b ** max(j - 1, 0) / half[1]
    patch = PolynomialPatch(v.chart, number(c), _pair(center), _pair(half), n)
    return quality(patch, v, (basis @ c, slope_u, slope_v), a, b)


def fit_spline(
    surface: SurfaceMesh | ArrayLike,
    *,
    chart: Literal["plane", "cylinder"] | Chart = "plane",
    region: TrochlearRegion | ArrayLike | None = None,
    weights: Literal["vertex", "area"] = "vertex",
    emphasis: Emphasis | None = None,
    tolerance: float = TOLERANCE,
    smoothing: float | None = None,
) -> PatchFit:
    """Fit a spline to all selected vertices, with the longest cells of those tried that reach the tolerance.

    Warns where it is not reached before there are as many coefficients as vertices, and returns the best fit.

    Args:
        surface, chart, region, weights, emphasis: as for `fit_patch`.
        tolerance: rms of the heights that is asked for [m].
        smoothing: how strongly curvature is penalised, as a length [m]; details shorter than it are lost. By default
            12.5 times the tolerance. Raise it for noisy scans.

    Raises:
        InputError: too few vertices, all of them on a line, values that are not finite, lengths that are not positive,
            or a surface folded over in this chart.
    """
    smoothing = SMOOTHING * tolerance if smoothing is None else smoothing
    for name, length in (("tolerance", tolerance), ("smoothing", smoothing)):
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"found {length!r}", where=name, expected="a positive length in metres, e.g. 0.02e-3")
    v = selected_vertices(surface, chart, region, weights, emphasis)
    if len(v.h) < FEWEST_VERTICES:
        raise InputError(
            f"{len(v.h)} vertices for a spline",
            where=v.source,
            expected=f"{FEWEST_VERTICES} or more",
            remedy="a finer mesh or a larger region",
        )
    v.check_folds()
    center, half = _rectangle(v)
    a, b = (v.u - center[0]) / half[0], (v.v - center[1]) / half[1]
    advice = "Try the cylinder as chart, " if chart == "plane" else "Try "
    cells, coefficients = _refined(a, b, v, half, tolerance, smoothing, advice)
    patch = SplinePatch(v.chart, number(coefficients), _pair(center), _pair(half))
    c, (n_u, n_v) = coefficients.ravel(), cells
    height, slope_a, slope_b = (_basis(a, b, cells, *orders) @ c for orders in ((0, 0), (1, 0), (0, 1)))
    fitted = height, slope_a * (0.5 * n_u / half[0]), slope_b * (0.5 * n_v / half[1])
    return quality(patch, v, fitted, a, b)


def _pair(x: Pair) -> tuple[Scalar, Scalar]:
    return number(x[0]), number(x[1])


def _domain(v: Vertices) -> tuple[Pair, Pair]:
    """Center and half size of a polynomial's rectangle.

    Along v the vertices' range. Along u the median, over eight strips of v, of the strips' ranges, so that one corner
    that sticks out does not stretch the patch over places without vertices.
    """
    low, high = float(v.v.min()), float(v.v.max())
    strip = np.clip(((v.v - low) / max(high - low, 1e-300) * 8).astype(int), 0, 7)
    used = np.unique(strip)
    u_low = float(np.median([v.u[strip == k].min() for k in used]))
    u_high = float(np.median([v.u[strip == k].max() for k in used]))
    half = 0.5 * (u_high - u_low), 0.5 * (high - low)
    if not min(half) > 0:
        raise InputError("all vertices lie on a line of the chart", where=v.source, remedy="a larger region")
    return (0.5 * (u_high + u_low), 0.5 * (high + low)), half


def _rectangle(v: Vertices) -> tuple[Pair, Pair]:
    """Center and half size of the rectangle that holds all vertices: where there are none a spline goes on gently."""
    spread = np.linalg.svd(np.stack([v.u - v.u.mean(), v.v - v.v.mean()]), compute_uv=False)
    if not spread[1] > 1e-6 * spread[0]:
        raise InputError("all vertices lie on a line of the chart", where=v.source, remedy="a larger region")
    (low_u, high_u), (low_v, high_v) = ((float(c.min()), float(c.max())) for c in (v.u, v.v))
    return (0.5 * (high_u + low_u), 0.5 * (high_v + low_v)), (0.5 * (high_u - low_u), 0.5 * (high_v - low_v))


def _monomials(a: Points, b: Points, degree: int) -> Points:
    """a^i b^j by columns, in the order of the patch's coefficients."""
    return np.stack([a**i * b**j for i, j in exponents(degree)], axis=1)


def _refined(
    a: Points, b: Points, v: Vertices, half: Pair, tolerance: float, smoothing: float, advice: str
) -> tuple[tuple[int, int], Points]:
    """Cells and coefficients of the coarsest attempt within the tolerance; else of the best, with a warning, in which
    the advice goes on."""
    best: tuple[float, tuple[int, int], Points] | None = None
    length, tried = LONGEST_CELL, None
    while True:
        cells = max(int(np.ceil(2 * half[0] / length)), 1), max(int(np.ceil(2 * half[1] / length)), 1)
        length *= SHRINKING
        if cells == tried:
            continue
        if best is not None and (cells[0] + 3) * (cells[1] + 3) > len(v.h):
            break
        tried, basis = cells, _basis(a, b, cells)
        c = _solved(basis, v, cells, half, smoothing)
        rms = float(np.sqrt(np.average((v.h - basis @ c) ** 2, weights=v.weight)))
        if best is None or rms < best[0]:
            best = rms, cells, c.reshape(cells[0] + 3, cells[1] + 3)
        if rms <= tolerance:
            return cells, best[2]
    warnings.warn(
        f"{v.source}: the spline comes within {1e3 * best[0]:.3f} mm rms of the {len(v.h)} vertices, not within"
        f" {1e3 * tolerance:.3f} mm. {advice}a finer or less noisy mesh, a smaller region or a larger tolerance.",
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


def _solved(basis: csr_matrix, v: Vertices, cells: tuple[int, int], half: Pair, smoothing: float) -> Points:
    """The coefficients (n,) that make mean weighted squared error + smoothing^4 * mean squared curvature least."""
    from scipy.sparse import csc_array, diags_array, kron
    from scipy.sparse.linalg import spsolve

    def derivative(n: int, order: int, step: float) -> csc_array:
        """By differences of a row of n + 3 coefficients."""
        stencil = {0: [1.0], 1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}[order]
        rows = n + 3 - order
        return csc_array(diags_array(stencil, offsets=range(order + 1), shape=(rows, n + 3)) / step**order)

    (n_u, n_v), (step_u, step_v) = cells, (2 * half[0] / cells[0], 2 * half[1] / cells[1])
    system = (basis.T.multiply(v.weight / len(v.h)) @ basis).tocsc()
    for share, along, across in ((1.0, 2, 0), (2.0, 1, 1), (1.0, 0, 2)):
        bend = kron(derivative(n_u, along, step_u), derivative(n_v, across, step_v), format="csc")
        system = system + share * smoothing**4 / (n_u * n_v) * (bend.T @ bend)
    # Heights from their mean: what is solved for is of the size of the relief, not of the distance to the axis.
    level = np.average(v.h, weights=v.weight)
    return level + spsolve(system, basis.T @ (v.weight / len(v.h) * (v.h - level)))
