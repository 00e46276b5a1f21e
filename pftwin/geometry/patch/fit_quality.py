"""How well a patch fits the vertices it was fitted to, polynomial or spline, and whether they cover its rectangle."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from pftwin.base.errors import PftwinWarning
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.geometry.patch.fit_input import Points
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.geometry.patch.spline import SplinePatch

ENOUGH = 0.75  # coverage below which a fit warns


@dataclass(frozen=True)
class PatchFit:
    """A fitted patch and how well it fits; lengths in metres.

    R^2 is 1 - sum w e^2 / sum w (h - mean h)^2 over the heights h, with the weights of the fit; rms likewise.
    """

    patch: PolynomialPatch | SplinePatch
    r_squared: float
    rms: float  # of the height residuals
    max_error: float  # largest height residual
    rms_normal: float  # of the residuals along the patch's normal
    max_error_normal: float
    n_vertices: int
    coverage: float  # share of the patch's rectangle, in 8 x 8 cells, that holds vertices

    @property
    def name(self) -> str:
        """The paper's name of the polynomial, such as "P5"; or "spline"."""
        return f"P{self.patch.degree}" if isinstance(self.patch, PolynomialPatch) else "spline"

    def __str__(self) -> str:
        cells = "" if isinstance(self.patch, PolynomialPatch) else " of {} x {} cells".format(*self.patch.cells)
        return (
            f"{self.name}{cells}: R^2 {100 * self.r_squared:.2f} %, rms {1e3 * self.rms:.3f} mm, "
            f"max {1e3 * self.max_error:.3f} mm, {self.n_vertices} vertices"
        )


def quality(
    patch: PolynomialPatch | SplinePatch,
    h: Points,
    fitted: tuple[Points, Points, Points],
    weight: Points,
    coverage: float,
) -> PatchFit:
    """Residuals in double precision.

    Args:
        patch: the patch.
        h: the vertices' heights (n,) [m].
        fitted: the patch's heights there [m] and its slopes along u and v [-], (n,) each.
        weight: of each vertex (n,).
        coverage: of the rectangle, see `covered`.
    """
    height, slope_u, slope_v = fitted
    if isinstance(patch.chart, CylindricalChart):
        slope_u = slope_u * float(patch.chart.radius) / height
    error = h - height
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


def covered(a: Points, b: Points, where: str, kind: str, cells: int = 8) -> float:
    """Share of the rectangle's cells that hold a vertex, out of as many cells as the vertices could fill.

    Warns where that is little. `kind` is what the message calls the patch.
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
            stacklevel=3,
        )
    return share
