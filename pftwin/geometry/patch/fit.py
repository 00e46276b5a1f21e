"""Fits a patch to the vertices of a mesh: a polynomial of any degree (the paper's P2, P4, P5), or a spline.

Michaud et al. 2024, section 2.4.2: the heights of the vertices in the trochlear region are fitted, and R^2 measures the
fit. A spline has as many cells as the surface requires and a mild penalty on curvature (a thin plate's bending energy,
after the P-splines of Eilers and Marx, Statistical Science 11 (1996) 89), which defines it where there are no vertices.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.leaves import number
from pftwin.base.spatial import Scalar
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import Chart
from pftwin.geometry.patch.fit_vertices import Emphasis, PatchFit, Vertices, quality, selected_vertices
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.geometry.patch.region import TrochlearRegion
from pftwin.geometry.patch.spline import SplinePatch
from pftwin.geometry.patch.spline_cells import FittedSpline, refined_spline

Pair = tuple[float, float]
ChartChoice = Literal["plane", "cylinder"] | Chart
SPLINE = "spline"
TOLERANCE = 0.02e-3  # rms of the heights [m]
SMOOTHING = 12.5  # smoothing length, in tolerances; damps wavelengths shorter than about 2 pi times this length


def parse_degree(name: str | int, *, others: str = "") -> int:
    """Parses the degree of a polynomial, such as "P5" or 5. `others`: other accepted words, for the message.

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
    """Normalizes the name of a patch: "P5" for "p5", "5" or 5, and "spline" for "Spline".

    Raises:
        InputError: anything else, or a degree below 1 or above 12.
    """
    if isinstance(name, str) and name.strip().lower() == SPLINE:
        return SPLINE
    return f"P{parse_degree(name, others=SPLINE)}"


def name_of(surface: Any) -> str | None:
    """Name of a patch, such as "P5" or "spline"; None for other surfaces."""
    return surface.name if isinstance(surface, (PolynomialPatch, SplinePatch)) else None


def fit_named(
    surface: SurfaceMesh | ArrayLike, name: str | int, *, chart: ChartChoice | None = None, **options: Any
) -> PatchFit:
    """Fits the patch of a name with `fit_patch` or, for "spline", `fit_spline`; options are passed on.

    Without a chart a polynomial is fitted over the plane; for a spline see `fit_spline`.

    Raises:
        InputError: an unknown name; otherwise as these functions.
    """
    name = parse_name(name)
    if name == SPLINE:
        return fit_spline(surface, chart=chart, **options)
    return fit_patch(surface, degree=name, chart="plane" if chart is None else chart, **options)


def fit_patch(
    surface: SurfaceMesh | ArrayLike,
    *,
    degree: int | str = 5,
    chart: ChartChoice = "plane",
    region: TrochlearRegion | ArrayLike | None = None,
    weights: Literal["vertex", "area"] = "vertex",
    emphasis: Emphasis | None = None,
) -> PatchFit:
    """Fits a polynomial to a surface's vertices by weighted linear least squares on coordinates scaled to [-1, 1].

    Args:
        surface: a mesh, or vertices, (n, 3) [m].
        degree: total degree, "P5" or 5.
        chart: a chart, or the name of one of the region's two.
        region: vertices to fit: a `TrochlearRegion` or a boolean mask (n,); None: all.
        weights: "vertex" weights all vertices equally, as the paper does; "area" by the area around each vertex, so
            that a locally refined mesh gives the same patch as a uniform one.
        emphasis: additional weights for part of the surface (for instance where a patella dislocates): an array (n,),
            or a function of the points (k, 3) [m].

    Raises:
        InputError: fewer vertices than coefficients; vertices that do not determine the coefficients; values that are
            not finite; a surface that folds over in this chart.
    """
    n = parse_degree(degree)
    need = len(exponents(n))
    v = selected_vertices(surface, chart, region, weights, emphasis)
    if len(v.h) < need:
        found = f"{len(v.h)} vertices for the {need} coefficients of P{n}"
        raise InputError(found, where=v.source, remedy="a finer mesh, a larger region or a lower degree")
    v.check_folds()
    center, half = _domain(v)
    a, b = (v.u - center[0]) / half[0], (v.v - center[1]) / half[1]
    basis = np.stack([a**i * b**j for i, j in exponents(n)], axis=1)
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
    chart: ChartChoice | None = None,
    region: TrochlearRegion | ArrayLike | None = None,
    weights: Literal["vertex", "area"] = "vertex",
    emphasis: Emphasis | None = None,
    tolerance: float = TOLERANCE,
    smoothing: float | None = None,
) -> PatchFit:
    """Fits a spline to all selected vertices, with the longest cells (among those tried) that reach the tolerance.

    Warns if the tolerance is not reached before there are as many coefficients as vertices, and returns the best fit.

    Args:
        surface, region, weights, emphasis: as for `fit_patch`.
        chart: a chart, or the name of one of the region's two. None: the plane, if the surface does not fold over in it
            and the tolerance is reached; else the one of the two with the better fit.
        tolerance: rms of the height residuals to reach [m].
        smoothing: weight of the penalty on curvature, as a length [m]; shorter details are lost. Default: 12.5 times
            the tolerance. Increase it for noisy scans.

    Raises:
        InputError: too few vertices, all of them on a line, values that are not finite, lengths that are not positive,
            or a surface that folds over in this chart.
    """
    smoothing = SMOOTHING * tolerance if smoothing is None else smoothing
    for name, length in (("tolerance", tolerance), ("smoothing", smoothing)):
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"found {length!r}", where=name, expected="a positive length in metres, e.g. 0.02e-3")

    def over(which: ChartChoice) -> Vertices:
        return selected_vertices(surface, which, region, weights, emphasis)

    if chart is None:
        spline, chosen = _over_better_chart(over, tolerance, smoothing)
    else:
        spline, chosen = refined_spline(over(chart), tolerance, smoothing), ""
    v = spline.vertices
    v.check_folds()
    if spline.rms > tolerance:
        first = "the cylinder as chart, " if chart == "plane" else ""
        reached = f"{1e3 * spline.rms:.3f} mm rms of the {len(v.h)} vertices, not within {1e3 * tolerance:.3f} mm"
        warnings.warn(
            f"{v.source}: the spline comes within {reached}."
            f" Try {first}a finer or less noisy mesh, a smaller region or a larger tolerance.",
            PftwinWarning,
            stacklevel=2,
        )
    patch = SplinePatch(v.chart, number(spline.coefficients), _pair(spline.center), _pair(spline.half))
    return replace(quality(patch, v, spline.values(), spline.a, spline.b), chart_chosen=chosen)


def _over_better_chart(
    over: Callable[[ChartChoice], Vertices], tolerance: float, smoothing: float
) -> tuple[FittedSpline, str]:
    """The spline over the plane if that reaches the tolerance, else over the chart with the better fit; and why."""
    plane = over("plane")
    if (share := plane.folded()) > 0 and (cylinder := over("cylinder")).folded() < share:
        why = f"over the cylinder, as on the plane the surface folds over at {100 * share:.2g} % of the vertices"
        return refined_spline(cylinder, tolerance, smoothing), why
    first = refined_spline(plane, tolerance, smoothing)
    if first.rms <= tolerance or (cylinder := over("cylinder")).folded() > 0:
        return first, ""
    second = refined_spline(cylinder, tolerance, smoothing)
    if first.rms <= second.rms:
        return first, ""
    return second, f"over the cylinder, as on the plane it comes within {1e3 * first.rms:.2g} mm alone"


def _pair(x: Pair) -> tuple[Scalar, Scalar]:
    return number(x[0]), number(x[1])


def _domain(v: Vertices) -> tuple[Pair, Pair]:
    """Centre and half size of a polynomial's rectangle.

    Along v this is the vertices' range; along u the median of the ranges in eight strips of v, so that a single
    protruding corner does not extend the patch over areas without vertices.
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
