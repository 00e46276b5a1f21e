"""Uniform cubic B-splines on [-1, 1]: the four basis functions of a cell, and the polynomials nearest to a spline.

n cells of equal length have n + 3 basis functions, of which four are not zero in a cell, so the cell and its basis are
found by arithmetic, without a search (de Boor, A Practical Guide to Splines, 1978).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Four = tuple[Any, Any, Any, Any]


# The four basis functions of a cell by powers of its own coordinate, 0 to 1: row p holds x^p.
CELL_POWERS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6


class Basis(NamedTuple):
    """The four basis functions of a cell, with derivatives by its own coordinate x, 0 to 1; scalars or arrays."""

    values: Four
    slopes: Four
    bends: Four


def cubic_basis(x: Any) -> Basis:
    """The basis functions at x of a cell."""
    y = 1 - x
    x2, y2 = x * x, y * y
    return Basis(
        (y2 * y * (1 / 6), 2 / 3 - x2 + 0.5 * (x2 * x), 2 / 3 - y2 + 0.5 * (y2 * y), x2 * x * (1 / 6)),
        (-0.5 * y2, 1.5 * x2 - 2 * x, 2 * y - 1.5 * y2, 0.5 * x2),
        (y, 3 * x - 2, 3 * y - 2, x),
    )


def cell_of(a: NDArray[np.float64], n: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """On the host: the cell of each a, and the place in it; beyond [-1, 1] the end cells' own polynomials."""
    t = 0.5 * n * (a + 1)
    k = np.clip(t.astype(np.int64), 0, n - 1)
    return k, t - k


@lru_cache(maxsize=64)
def polynomial_projection(n: int, degree: int) -> NDArray[np.float64]:
    """(degree + 1, n + 3): from the coefficients of a spline of n cells to the Legendre series nearest in the mean."""
    nodes, weights = np.polynomial.legendre.leggauss(degree // 2 + 3)  # exact: cubics times Legendre polynomials
    a = ((2 * np.arange(n)[:, None] + 1 + nodes) / n - 1).ravel()
    weight = np.tile(weights / n, n)
    k, x = cell_of(a, n)
    series = np.polynomial.legendre.legvander(a, degree) * weight[:, None] * (np.arange(degree + 1) + 0.5)
    out = np.zeros((degree + 1, n + 3))
    for j, values in enumerate(cubic_basis(x).values):
        np.add.at(out.T, k + j, values[:, None] * series)
    out.flags.writeable = False
    return out


@lru_cache(maxsize=16)
def legendre_to_powers(degree: int) -> NDArray[np.float64]:
    """(degree + 1, degree + 1): row i holds the powers' coefficients of the i-th Legendre polynomial."""
    out = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        out[i, : i + 1] = np.polynomial.legendre.leg2poly(np.eye(degree + 1)[i])[: i + 1]
    out.flags.writeable = False
    return out
