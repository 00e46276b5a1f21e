"""Bivariate polynomials of total degree n over a chart (P2, P4, P5, ...), and the base class of rectangular patches.

Source: Michaud et al. 2024, section 2.4.2.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar
from pftwin.geometry.patch.charts import Chart, Jet
from pftwin.geometry.patch.closest import SurfaceProfile


def exponents(degree: int) -> list[tuple[int, int]]:
    """Exponents (i, j) of the monomials a^i b^j, in the order of a patch's coefficients."""
    return [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]


@lru_cache(maxsize=16)
def legendre_to_powers(degree: int) -> NDArray[np.float64]:
    """Matrix (degree + 1, degree + 1) whose row i holds the power coefficients of the i-th Legendre polynomial."""
    out = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        out[i, : i + 1] = np.polynomial.legendre.leg2poly(np.eye(degree + 1)[i])[: i + 1]
    out.flags.writeable = False
    return out


class RectanglePatch(eqx.Module):
    """A height over a rectangle of a chart, extrapolated beyond it.

    Beyond the rectangle a fitted function is meaningless and may fold back. There the patch is its bilinear Taylor
    expansion about the nearest point of the rectangle: value and slope are continuous (C1), and `outside` is positive.
    """

    chart: Chart
    coefficients: Array | tuple[Scalar, ...] = eqx.field(metadata=quantity("m"))
    center: tuple[Scalar, Scalar] = eqx.field(metadata=quantity("m"))  # (u0, v0)
    half_size: tuple[Scalar, Scalar] = eqx.field(metadata=quantity("m", positive=True))  # (half_u, half_v)

    @abstractmethod
    def _inside(self, a: Scalar, b: Scalar) -> tuple[Jet, Scalar, Scalar]:
        """Height and derivatives by a and b, both within +-1; and the mixed third derivatives, aab and abb."""

    @abstractmethod
    def with_waves(self, series: NDArray[np.float64]) -> Self:
        """Adds sum of s_ij P_i(a) P_j(b) to the height [m], P the Legendre polynomials; on the host.

        The degree of a polynomial patch increases if that of the series is higher.

        Args:
            series: s_ij, (n, n) [m], zero where i + j is n or more.
        """

    def outside(self, u: Scalar, v: Scalar) -> Scalar:
        """Distance of a point beyond the fitted rectangle [m]; zero inside."""
        du = jnp.maximum(jnp.abs(u - self.center[0]) - self.half_size[0], 0.0)
        dv = jnp.maximum(jnp.abs(v - self.center[1]) - self.half_size[1], 0.0)
        return jnp.maximum(du, dv)

    def clipped(self, v: Scalar) -> Scalar:
        """The coordinate v limited to the fitted rectangle [m]."""
        return jnp.clip(v, self.center[1] - self.half_size[1], self.center[1] + self.half_size[1])

    def height(self, u: Scalar, v: Scalar) -> Scalar:
        """Height [m], extrapolated beyond the rectangle."""
        return self.jet(u, v).f

    def jet(self, u: Scalar, v: Scalar) -> Jet:
        """Height, gradient and Hessian at (u, v), in closed form, also beyond the rectangle.

        There the curvature along the edge is extrapolated linearly with the mixed third derivative. Otherwise Newton
        steps to a closest point converge slowly or never where the slope of a wall varies along the edge.
        """
        scale_u, scale_v = 1 / self.half_size[0], 1 / self.half_size[1]
        a, b = (u - self.center[0]) * scale_u, (v - self.center[1]) * scale_v
        ai, bi = jnp.clip(a, -1.0, 1.0), jnp.clip(b, -1.0, 1.0)
        j, uuv, uvv = self._inside(ai, bi)
        da, db = a - ai, b - bi
        fa, fb = j.u + j.uv * db, j.v + j.uv * da
        return Jet(
            j.f + j.u * da + j.v * db + j.uv * (da * db),
            fa * scale_u,
            fb * scale_v,
            jnp.where(da == 0, j.uu + uuv * db, 0.0) * (scale_u * scale_u),
            j.uv * (scale_u * scale_v),
            jnp.where(db == 0, j.vv + uvv * da, 0.0) * (scale_v * scale_v),
        )


class PolynomialPatch(RectanglePatch):
    """height = sum of c_ij a^i b^j, with a = (u - u0) / half_u, b = (v - v0) / half_v and |a|, |b| <= 1."""

    degree: int = eqx.field(static=True)

    @property
    def name(self) -> str:
        """Name in the paper, such as "P5"."""
        return f"P{self.degree}"

    def _inside(self, a: Scalar, b: Scalar) -> tuple[Jet, Scalar, Scalar]:
        return _polynomial_jet(self.unstacked().coefficients, self.degree, a, b)

    def unstacked(self) -> PolynomialPatch:
        """The same patch with one array per coefficient; call it once, before a loop."""
        if isinstance(self.coefficients, tuple):
            return self
        n = len(exponents(self.degree))
        coefficients = tuple(self.coefficients[..., i] for i in range(n))
        return eqx.tree_at(lambda p: p.coefficients, self, coefficients)

    def with_waves(self, series: NDArray[np.float64]) -> Self:  # noqa: D102
        powers = legendre_to_powers(len(series) - 1)
        degree = max(self.degree, len(series) - 1)
        square = np.zeros((degree + 1, degree + 1))
        square[: len(series), : len(series)] = powers.T @ series @ powers
        for (i, j), own in zip(exponents(self.degree), np.asarray(self.coefficients), strict=True):
            square[i, j] += own
        coefficients = jnp.asarray([square[e] for e in exponents(degree)], dtype=float)
        return replace(self, coefficients=coefficients, degree=degree)

    def profile(self, u: Scalar) -> SurfaceProfile:
        """The patch along v at one u, at a fifth of the cost of a jet for each v.

        Only valid for v on the fitted rectangle; u may be beyond it.
        """
        c, n = self.unstacked().coefficients, self.degree
        index = {e: k for k, e in enumerate(exponents(n))}
        scale_u, scale_v = 1 / self.half_size[0], 1 / self.half_size[1]
        a = (u - self.center[0]) * scale_u
        ai = jnp.clip(a, -1.0, 1.0)
        rows = [_horner([c[index[i, j]] for i in range(n + 1 - j)], ai) for j in range(n + 1)]
        slopes = [slope * scale_u for _, slope, _ in rows if slope is not None]
        heights = [h if slope is None else h + (a - ai) * slope for h, slope, _ in rows]
        inside = jnp.where(a == ai, scale_u * scale_u, 0.0)

        def across(v: Scalar) -> Scalar:
            return (v - self.center[1]) * scale_v

        def height_and_slope(v: Scalar) -> tuple[Scalar, Scalar]:
            b = across(v)
            return _value(heights, b), _value(slopes, b)

        def curvature(v: Scalar) -> Scalar:
            bends = [bend for *_, bend in rows if bend is not None]
            return inside * _value(bends, across(v)) if bends else jnp.zeros_like(v)

        return height_and_slope, curvature


def _value(c: Sequence[Scalar], x: Scalar) -> Scalar:
    p = c[-1]
    for coefficient in reversed(c[:-1]):
        p = p * x + coefficient
    return p


def _polynomial_jet(c: Sequence[Scalar] | Array, degree: int, a: Scalar, b: Scalar) -> tuple[Jet, Scalar, Scalar]:
    """Jet and the mixed third derivatives, aab and abb, by Horner's scheme in a for each power of b, then in b."""
    index = {e: k for k, e in enumerate(exponents(degree))}
    rows = [_horner([c[index[i, j]] for i in range(degree + 1 - j)], a) for j in range(degree + 1)]
    f, fb, fbb = _horner([r[0] for r in rows], b)
    slopes, curvatures = [r[1] for r in rows if r[1] is not None], [r[2] for r in rows if r[2] is not None]
    fa, fab, fabb = _horner(slopes, b) if slopes else (None, None, None)
    faa, faab, _ = _horner(curvatures, b) if curvatures else (None, None, None)
    nought = jnp.zeros_like(a)
    f, fa, fb, faa, fab, fbb, faab, fabb = (nought if d is None else d for d in (f, fa, fb, faa, fab, fbb, faab, fabb))
    return Jet(f, fa, fb, faa, fab, fbb), faab, fabb


def _horner(c: Sequence[Scalar], x: Scalar) -> tuple[Scalar, Scalar | None, Scalar | None]:
    """p(x), p'(x) and p''(x); a derivative that is identically zero is None."""
    p: Scalar = c[-1]
    d: Scalar | None = None
    half_dd: Scalar | None = None
    for coefficient in reversed(c[:-1]):
        if d is not None:
            half_dd = d if half_dd is None else half_dd * x + d
        d = p if d is None else d * x + p
        p = p * x + coefficient
    return p, d, None if half_dd is None else 2 * half_dd
