"""The slow references: every triangle against the point, every triangle against every other. For tests. Host side.

Written another way than the fast queries on purpose: distances by minimising over face, edges and corners one by one,
intersections by the separating axis theorem.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pftwin.base.arrays import Floats


def distances(corners: Floats, point: Floats) -> Floats:
    """From a point (3,) to each of the triangles (n, 3, 3), (n,)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    best = np.full(len(corners), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        way = end - start
        share = np.einsum("ij,ij->i", point - start, way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
        best = np.minimum(best, np.linalg.norm(start + np.clip(share, 0, 1)[:, None] * way - point, axis=1))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    flat = size == 0
    unit = normal / np.where(flat, 1, size)[:, None]
    height = np.einsum("ij,ij->i", point - a, unit)
    foot = point - height[:, None] * unit
    # Barycentric coordinates of the foot, as areas.
    weights = [np.einsum("ij,ij->i", np.cross(q - foot, r - foot), unit) for q, r in ((b, c), (c, a), (a, b))]
    inside = (np.min(weights, axis=0) >= 0) & ~flat
    return np.where(inside, np.minimum(best, np.abs(height)), best)


def intersecting(first: Floats, second: Floats) -> NDArray[np.int64]:
    """Pairs (k, 2) of triangles of (n, 3, 3) and (m, 3, 3) that have a point in common, in ascending order."""
    one, other = _within(first, second), _within(second, first)
    first, second = first[one], second[other]
    lows, highs = zip(*((t.min(axis=1), t.max(axis=1)) for t in (first, second)), strict=True)
    found = [np.empty((0, 2), int)]
    for start in range(0, len(second), 64):  # their boxes, some against all
        some = slice(start, start + 64)
        near = np.ones((len(first), len(second[some])), dtype=bool)
        for k in range(3):
            near &= lows[0][:, None, k] <= highs[1][None, some, k]
            near &= highs[0][:, None, k] >= lows[1][None, some, k]
        pairs = np.argwhere(near)
        pairs[:, 1] += start
        found.append(pairs[meet(first[pairs[:, 0]], second[pairs[:, 1]])])
    every = np.concatenate(found)
    every = np.stack([one[every[:, 0]], other[every[:, 1]]], axis=1)
    return every[np.lexsort((every[:, 1], every[:, 0]))]


def _within(some: Floats, others: Floats) -> NDArray[np.int64]:
    """Which triangles reach into the box around all the others."""
    if not len(some) or not len(others):
        return np.arange(len(some))
    low, high = others.min(axis=(0, 1)), others.max(axis=(0, 1))
    return np.flatnonzero(((some.max(axis=1) >= low) & (some.min(axis=1) <= high)).all(axis=1))


def ray_depths(points: Floats, normals: Floats, corners: Floats, limit: float) -> Floats:
    """How deep each of n points is below triangles (m, 3, 3), by the longest ray against its normal; -1: none, (n,).

    Rays leave through a triangle from its inner side, no farther than the limit. Triangles farther off than
    that are left out by the distance of their middles.
    """
    depths = np.full(len(points), -1.0)
    a, b, c = np.moveaxis(corners, 1, 0)
    face = np.cross(b - a, c - a)
    middles = corners.mean(axis=1)
    largest = np.linalg.norm(corners - middles[:, None], axis=2).max()
    near = cKDTree(middles).query_ball_point(points, (limit + largest) * (1 + 1e-6))
    for k, (p, n) in enumerate(zip(points, normals, strict=True)):
        some = np.asarray(near[k], dtype=int)
        steep = -(face[some] @ n)
        out, steep = some[steep > 0], steep[steep > 0]
        if not len(out):
            continue
        t = np.einsum("ij,ij->i", a[out] - p, face[out]) / steep
        hit = p - t[:, None] * n
        # Barycentric coordinates of the point hit.
        inside = np.ones(len(out), dtype=bool)
        for q, r in ((a, b), (b, c), (c, a)):
            inside &= np.einsum("ij,ij->i", np.cross(r[out] - q[out], hit - q[out]), face[out]) >= 0
        inside &= (t >= 0) & (t <= limit)
        if inside.any():
            depths[k] = t[inside].max()
    return depths


def meet(s: Floats, t: Floats) -> NDArray[np.bool_]:
    """Whether triangles (k, 3, 3) meet, one by one: no axis separates them."""
    sides, others = np.roll(s, -1, axis=1) - s, np.roll(t, -1, axis=1) - t
    normals, normal = np.cross(sides[:, 0], sides[:, 1]), np.cross(others[:, 0], others[:, 1])
    axes = [normals, normal]
    axes += [np.cross(sides[:, i], others[:, j]) for i in range(3) for j in range(3)]
    axes += [np.cross(normals, sides[:, i]) for i in range(3)]  # for triangles in one plane
    axes += [np.cross(normal, others[:, j]) for j in range(3)]
    meet = np.ones(len(s), dtype=bool)
    for axis in axes:
        p, q = np.einsum("nkj,nj->nk", s, axis), np.einsum("nkj,nj->nk", t, axis)
        meet &= (p.min(axis=1) <= q.max(axis=1)) & (q.min(axis=1) <= p.max(axis=1))
    return meet
