"""A bicubic tensor-product spline over a chart: C2, as accurate as needed, at about the cost of a polynomial.

A cell's height needs 4 x 4 coefficients, however many cells there are; on uniform knots their position in a table is
arithmetic. Before a loop the coefficients are converted to a table with one row per cell: the sixteen coefficients of
its monomials. A jet loads these one by one: a row loaded as one array is fused by XLA into its uses and reloaded for
each of its numbers, with the computation of its index, which is sixteen times the code for each jet that starts at the
result of another; with two such jets in a batch the compilation did not end.

The fan that looks for facets (`pftwin.geometry.contact.facets`) samples thirteen heights per step and only selects
starts. For it the table comes with the polynomial that is nearest to the spline in the mean square: loading a row for
each sample would double the cost of a batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar
from pftwin.geometry.patch.charts import Jet
from pftwin.geometry.patch.closest import SurfaceProfile
from pftwin.geometry.patch.polynomial import PolynomialPatch, RectanglePatch, exponents, legendre_to_powers

# The four basis functions on a cell as polynomials of its coordinate x, 0 to 1: row p holds the coefficients of x^p.
CELL_POWERS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
FAN_DEGREE = 8  # of the polynomial that the fan samples: within 0.1 mm rms of a trochlea


class PreparedSpline(NamedTuple):
    """Tables made from a spline's coefficients before a loop."""

    table: Array  # (n_u * n_v, 16): coefficient of x^p y^q in column 4 p + q, with x and y from 0 to 1 in the cell
    fan: PolynomialPatch  # the polynomial that `profile` evaluates


class SplinePatch(RectanglePatch):
    """height = sum of c_ij N_i(a) N_j(b), a = (u - u0) / half_u, b = (v - v0) / half_v, with |a|, |b| <= 1.

    N are the uniform cubic B-splines on [-1, 1] (de Boor, A Practical Guide to Splines, 1978): n + 3 for n cells of
    equal length, of which four are nonzero on a cell.
    """

    coefficients: Array = eqx.field(metadata=quantity("m"))  # (n_u + 3, n_v + 3) for n_u x n_v cells
    loop: PreparedSpline | None = None  # set by `unstacked`

    name: ClassVar[str] = "spline"

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells along u and v."""
        return self.coefficients.shape[-2] - 3, self.coefficients.shape[-1] - 3

    def unstacked(self) -> SplinePatch:
        """The same patch with the table of its cells and the polynomial for the fan; call it once, before a loop."""
        if self.loop is not None:
            return self
        return eqx.tree_at(lambda s: s.loop, self, self._loop(), is_leaf=lambda x: x is None)

    def _loop(self) -> PreparedSpline:
        return self.loop or PreparedSpline(self._table(), self.nearest_polynomial())

    def _table(self) -> Array:
        n_u, n_v = self.cells
        powers, c = jnp.asarray(CELL_POWERS, float), self.coefficients
        along = jnp.stack([c[i : i + n_u] for i in range(4)])  # (4, n_u, n_v + 3)
        windows = jnp.stack([along[:, :, j : j + n_v] for j in range(4)])  # (4 across, 4 along, n_u, n_v)
        return jnp.einsum("pi,jiuv,qj->uvpq", powers, windows, powers).reshape(n_u * n_v, 16)

    def nearest_polynomial(self, degree: int = FAN_DEGREE) -> PolynomialPatch:
        """The polynomial patch of a total degree that is nearest in the mean square over the rectangle."""
        along, across = (jnp.asarray(polynomial_projection(n, degree), float) for n in self.cells)
        powers = jnp.asarray(legendre_to_powers(degree), float)
        series = along @ self.coefficients @ across.T
        # Legendre polynomials are orthogonal, so truncation gives the nearest polynomial of the remaining terms.
        series = jnp.where(jnp.add.outer(jnp.arange(degree + 1), jnp.arange(degree + 1)) <= degree, series, 0.0)
        square = powers.T @ series @ powers
        c = tuple(square[i, j] for i, j in exponents(degree))
        return PolynomialPatch(self.chart, c, self.center, self.half_size, degree)

    def with_waves(self, series: NDArray[np.float64]) -> Self:  # noqa: D102
        along, across = (interpolation(n, len(series) - 1) for n in self.cells)
        added = jnp.asarray(along @ series @ across.T, dtype=float)
        return replace(self, coefficients=self.coefficients + added, loop=None)

    def profile(self, u: Scalar) -> SurfaceProfile:
        """An approximation of the patch along v at one u, to start searches; only for v on the fitted rectangle."""
        return self._loop().fan.profile(u)

    def _inside(self, a: Scalar, b: Scalar) -> tuple[Jet, Scalar, Scalar]:
        n_u, n_v = self.cells
        (i, x), (k, y) = _cell(a, n_u), _cell(b, n_v)
        cell = _row(self._loop().table, self.coefficients, i, k)
        across = [_cubic(cell[4 * p : 4 * p + 4], y) for p in range(4)]  # a row for each power of x
        (f, f_x, f_xx), (f_y, f_xy, f_xxy), (f_yy, f_xyy, _) = (
            _cubic([row[order] for row in across], x) for order in range(3)
        )
        per_a, per_b = 0.5 * n_u, 0.5 * n_v
        aa, ab, bb = per_a * per_a, per_a * per_b, per_b * per_b
        jet = Jet(f, f_x * per_a, f_y * per_b, f_xx * aa, f_xy * ab, f_yy * bb)
        return jet, f_xxy * (aa * per_b), f_xyy * (per_a * bb)


def _cell(a: Scalar, n: int) -> tuple[Scalar, Scalar]:
    """Which of n cells a coordinate within +-1 is in, and the coordinate in that cell, 0 to 1."""
    t = (a + 1) * (0.5 * n)
    k = jnp.clip(t.astype(jnp.int32), 0, n - 1)  # any valid cell for a value that is not finite
    return k, t - k.astype(t.dtype)


@jax.custom_jvp
def _row(table: Array, coefficients: Array, i: Scalar, k: Scalar) -> tuple[Scalar, ...]:
    """The sixteen numbers of the table's row for cell (i, k)."""
    return _loaded(table, i * (coefficients.shape[1] - 3) + k)


@_row.defjvp
def _row_jvp(primals: tuple, tangents: tuple) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Derivatives by the coefficients, not by the table, so that reverse mode accumulates the smaller arrays."""
    _, _, i, k = primals
    changes, powers = tangents[1], jnp.asarray(CELL_POWERS, tangents[1].dtype)

    def change(i: Scalar, k: Scalar) -> Array:
        window = jax.lax.dynamic_slice(changes, (i, k), (4, 4))
        return (powers @ window @ powers.T).reshape(16)

    row = jnp.vectorize(change, signature="(),()->(n)")(i, k)
    return _row(*primals), tuple(row[..., n] for n in range(16))


@custom_vmap
def _loaded(table: Array, cell: Scalar) -> tuple[Scalar, ...]:
    """A row's numbers, one by one."""
    flat = table.reshape(-1)
    return tuple(flat.at[16 * cell + n].get(mode="promise_in_bounds") for n in range(16))


@_loaded.def_vmap
def _loaded_of_many(
    size: int, mapped: list[bool], table: Array, cell: Scalar
) -> tuple[tuple[Scalar, ...], tuple[bool, ...]]:
    """Concatenates the tables of a batch into one, with consecutive row numbers."""
    if not mapped[1]:
        cell = jnp.broadcast_to(cell, (size, *cell.shape))
    if mapped[0]:
        first = table.shape[1] * jnp.arange(size, dtype=cell.dtype)
        cell = cell + first.reshape(-1, *(1,) * (cell.ndim - 1))
        table = table.reshape(-1, 16)
    return _loaded(table, cell), (True,) * 16


def _cubic(c: Sequence[Scalar], x: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Value, first and second derivative of a cubic."""
    steep = c[2] + c[3] * x
    return c[0] + x * (c[1] + x * steep), c[1] + x * (2 * steep + c[3] * x), 2 * steep + 4 * (c[3] * x)


def cubic_basis(x: Floats) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Values and derivatives of a cell's four basis functions at its coordinate x, 0 to 1; on the host."""
    y = 1 - x
    x2, y2 = x * x, y * y
    return (
        (y2 * y * (1 / 6), 2 / 3 - x2 + 0.5 * (x2 * x), 2 / 3 - y2 + 0.5 * (y2 * y), x2 * x * (1 / 6)),
        (-0.5 * y2, 1.5 * x2 - 2 * x, 2 * y - 1.5 * y2, 0.5 * x2),
    )


def cell_of(a: NDArray[np.float64], n: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cell of each a, and the coordinate in it; beyond [-1, 1] the end cells' polynomials continue. On the host."""
    t = 0.5 * n * (a + 1)
    k = np.clip(t.astype(np.int64), 0, n - 1)
    return k, t - k


@lru_cache(maxsize=64)
def polynomial_projection(n: int, degree: int) -> NDArray[np.float64]:
    """Matrix (degree + 1, n + 3) from the coefficients of n cells to the Legendre series nearest in the mean square."""
    nodes, weights = np.polynomial.legendre.leggauss(degree // 2 + 3)  # exact: cubics times Legendre polynomials
    a = ((2 * np.arange(n)[:, None] + 1 + nodes) / n - 1).ravel()
    weight = np.tile(weights / n, n)
    k, x = cell_of(a, n)
    series = np.polynomial.legendre.legvander(a, degree) * weight[:, None] * (np.arange(degree + 1) + 0.5)
    out = np.zeros((degree + 1, n + 3))
    for j, values in enumerate(cubic_basis(x)[0]):
        np.add.at(out.T, k + j, values[:, None] * series)
    out.flags.writeable = False
    return out


@lru_cache(maxsize=16)
def interpolation(n: int, degree: int) -> NDArray[np.float64]:
    """Matrix (n + 3, degree + 1) from a Legendre series to the coefficients of the spline of n cells that interpolates
    it at the knots and at one more beyond either end."""
    a = 2 * (np.arange(n + 3) - 1) / n - 1
    k, x = cell_of(a, n)
    basis = np.zeros((n + 3, n + 3))
    for j, values in enumerate(cubic_basis(x)[0]):
        np.add.at(basis, (np.arange(n + 3), k + j), values)
    out = np.asarray(np.linalg.solve(basis, np.polynomial.legendre.legvander(a, degree)), dtype=np.float64)
    out.flags.writeable = False
    return out
