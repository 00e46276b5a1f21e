"""The order of triangles in a complete binary tree by median splits, and the arrays that a node's triangles make.

Every split halves a node's triangles, to within one, along the axis in which their middles reach farthest. All leaves
have as many places; the last of some stays empty and is filled with a copy of the leaf's first triangle. So a node's
descendants at any level below, and its triangles, are neighbours in memory.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def depth_for(n: int, leaf: int) -> int:
    """Levels below the root of a complete tree whose leaves hold at most `leaf` of n triangles."""
    return max(0, math.ceil(math.log2(n / leaf)))


def median_order(middles: NDArray[np.float64], leaf: int, depth: int) -> NDArray[np.int64]:
    """Which triangle is in which place, -1 in the empty ones: (2^depth * leaf,).

    Args:
        middles: (n, 3) of the triangles.
        leaf: places in a leaf.
        depth: of the tree, at least `depth_for` the triangles.
    """
    n = len(middles)
    rows, counts = np.arange(n)[None], np.array([n])
    for _ in range(depth):
        rows, counts = _split(middles, rows, counts)
    places = np.full((2**depth, leaf), -1)
    places[:, : rows.shape[1]] = rows
    places[np.arange(leaf) >= counts[:, None]] = -1
    return places.ravel()


def _split(middles: NDArray, rows: NDArray, counts: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Every row's triangles in two rows; beyond its count a row holds copies of its first."""
    n_rows, width = rows.shape
    p = middles[rows]
    axis = np.argmax(np.ptp(p, axis=1), axis=1)
    key = np.take_along_axis(p, axis[:, None, None], axis=2)[:, :, 0]
    key = np.where(np.arange(width) < counts[:, None], key, np.inf)
    rows = np.take_along_axis(rows, np.argsort(key, axis=1, kind="stable"), axis=1)
    left, right = (counts + 1) // 2, counts // 2
    half = (width + 1) // 2
    place = np.arange(half)
    first = np.where(place < left[:, None], place, 0)
    second = np.minimum(left[:, None] + np.where(place < right[:, None], place, 0), width - 1)
    halves = np.stack([np.take_along_axis(rows, k, axis=1) for k in (first, second)], axis=1)
    return halves.reshape(2 * n_rows, half), np.stack([left, right], axis=1).ravel()
