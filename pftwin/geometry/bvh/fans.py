"""Trees with up to sixteen children at a node, laid out for searches that take one node after the other.

A node's children are sixteen lanes of one instruction: every number of their bounding volumes lies side by side. The
root's fan is smaller or as large, all others are full; dead lanes are infinitely far away. Nodes are numbered level by
level, those with children first, then the leaves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.bvh import discs
from pftwin.geometry.bvh.order import median_order
from pftwin.geometry.bvh.tree import ROUNDING

FAN = 16
STRIDE = 4  # binary levels in a fan
FAR = 1e15  # [m] where dead lanes are


class Fans(NamedTuple):
    """A complete binary tree (see `bvh.tree`), every fourth level of it kept."""

    bounds: NDArray[np.float32]  # (nodes with children, 8, 16) of the children: discs, or balls (4 numbers)
    first: NDArray[np.int32]  # (nodes with children,) the first child's number
    places: NDArray[np.int64]  # (leaves, lanes) which triangle; in an empty lane, which holds a copy, -1 - its original


def leaves_for(n: int, lanes: int) -> int:
    """Levels of the binary tree whose leaves hold at most `lanes` of n triangles."""
    return max(0, int(np.ceil(np.log2(n / lanes))))


def fans_of(corners: NDArray[np.float64], lanes: int, balls: bool) -> Fans:
    """The tree of triangles (n, 3, 3) [m] with at most `lanes` in a leaf.

    Args:
        corners: of the triangles.
        lanes: most triangles in a leaf; as many lanes are used as the fullest needs.
        balls: bounds are balls about the triangles' centroids: middle and radius; else discs about their corners.
    """
    n = len(corners)
    depth = leaves_for(n, lanes)
    middles = corners.mean(axis=1)
    placed = median_order(middles, lanes, depth).reshape(2**depth, lanes)
    used = int((placed >= 0).sum(axis=1).max())
    placed = placed[:, :used]
    filled = np.where(placed >= 0, placed, placed[:, :1])
    first_level = depth if depth < STRIDE else depth % STRIDE or STRIDE
    levels = list(range(first_level, depth + 1, STRIDE))
    margin = ROUNDING * float(np.abs(corners).max())
    flat = filled.ravel()
    vectors = 0.5 * np.cross(corners[flat, 1] - corners[flat, 0], corners[flat, 2] - corners[flat, 0])
    tables = []
    for level in levels:
        if balls:
            tables.append(_balls(middles[flat].reshape(2**level, -1, 3), margin))
        else:
            points = corners[flat].reshape(2**level, -1, 3)
            tables.append(discs.fit(points, vectors.reshape(2**level, -1, 3), margin))
    root = np.zeros((FAN, tables[0].shape[1]), dtype=np.float32)
    root[:, 0] = FAR
    root[: len(tables[0])] = tables[0]
    rows = [root, *tables[1:]]
    bounds = np.concatenate([r.reshape(-1, FAN, r.shape[1]) for r in rows])
    parents = [1, *(2**level for level in levels[:-1])]
    begins = np.cumsum([1, *(2**level for level in levels)])[: len(levels)]  # each level's first number
    steps = [np.arange(k) * FAN + b for k, b in zip(parents, begins, strict=True)]
    index = np.where(placed >= 0, placed, -1 - filled)
    return Fans(np.ascontiguousarray(bounds.swapaxes(1, 2)), np.concatenate(steps).astype(np.int32), index)


def rows_of(fans: Fans) -> NDArray[np.float32]:
    """The bounds child after child, (16 nodes, 8 or 4)."""
    return np.ascontiguousarray(fans.bounds.swapaxes(1, 2)).reshape(-1, fans.bounds.shape[1])


def _balls(points: NDArray[np.float64], margin: float) -> NDArray[np.float32]:
    """Middle and radius (nodes, 4) of points (nodes, k, 3)."""
    middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
    middle = middle.astype(np.float32)
    radius = np.linalg.norm(points - middle[:, None].astype(np.float64), axis=2).max(axis=1) + margin
    return np.concatenate([middle, radius[:, None].astype(np.float32)], axis=1)
