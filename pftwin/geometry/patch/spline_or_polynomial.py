"""The patch that goes by a name: "P2", "P4", "P5" or another polynomial, or "spline"."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.fit_quality import PatchFit
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.geometry.patch.polynomial_fit import fit_patch, parse_degree
from pftwin.geometry.patch.spline import SplinePatch

SPLINE = "spline"


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
    if isinstance(surface, PolynomialPatch):
        return f"P{surface.degree}"
    return SPLINE if isinstance(surface, SplinePatch) else None


def fit_named(surface: SurfaceMesh | ArrayLike, name: str | int, **options: Any) -> PatchFit:
    """The patch of that name, fitted to a surface; options as for `fit_patch`, or `fit_spline` for "spline".

    Raises:
        InputError: no such name; otherwise as the two.
    """
    name = parse_name(name)
    if name == SPLINE:
        from pftwin.geometry.patch.spline_fit import fit_spline

        return fit_spline(surface, **options)
    return fit_patch(surface, degree=name, **options)
