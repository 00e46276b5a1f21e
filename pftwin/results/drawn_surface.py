"""Contact surfaces as vertices and triangles: meshes taken out of their trees, fitted surfaces sampled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.spatial import Vec3
from pftwin.geometry.patch.closest import Surface

ALONG = 49  # samples of a fitted rectangle, either way: a chord of a trochlea is then within 0.02 mm of it
STEP = 1.5e-3  # of a continuation, which is all but flat [m]
MARGIN = 4e-3  # how far past the outermost contact point a surface is continued [m]
ROUNDING = 1e-9  # vertices that are nearer are one [m]
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]  # vertices (n, 3) [m], triangles (m, 3)


def has_rectangle(surface: Any) -> bool:
    """Whether a smooth surface says where it ends: a surface of one's own need not."""
    return hasattr(surface, "center") and hasattr(surface, "half_size")


def fitted_surface(surface: Surface) -> Mesh:
    """A smooth surface over the rectangle to which it was fitted."""
    lines = [np.linspace(low, high, ALONG) for low, high in _rectangle(surface)]
    return _sampled(surface, *lines)


def continuation(surface: Surface, points: NDArray[np.float64]) -> Mesh | None:
    """A smooth surface beyond its rectangle, as far as contact points (k, 3) [m] need it; None where they do not."""
    if not points.size:
        return None
    at = surface.chart.coordinates(Vec3(*points.T))
    lines, grown = [], False
    for (low, high), c in zip(_rectangle(surface), (np.asarray(at.x), np.asarray(at.y)), strict=True):
        first, last = min(low, c.min() - MARGIN), max(high, c.max() + MARGIN)
        grown = grown or c.min() < low or c.max() > high
        before, beyond = (np.linspace(*ends, 2 + int(np.ptp(ends) / STEP)) for ends in ((first, low), (high, last)))
        lines.append(np.unique(np.concatenate([before, np.linspace(low, high, ALONG), beyond])))
    return _sampled(surface, *lines, outside=True) if grown else None


def indexed(corners: ArrayLike) -> Mesh:
    """Vertices and triangles from corners (places, 9): empty places of a tree, which hold copies, drop out."""
    rows = np.asarray(corners, dtype=np.float64)
    keys, which = np.unique(np.round(rows.reshape(-1, 3) / ROUNDING).astype(np.int64), axis=0, return_inverse=True)
    faces = which.reshape(-1, 3)
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return np.multiply(keys, ROUNDING, dtype=np.float64), faces[np.sort(first)]


def _rectangle(surface: Any) -> list[tuple[float, float]]:
    return [(float(c - h), float(c + h)) for c, h in zip(surface.center, surface.half_size, strict=True)]


def _sampled(surface: Any, u: NDArray[np.float64], v: NDArray[np.float64], *, outside: bool = False) -> Mesh:
    """The mesh of a grid; of its cells outside the surface's rectangle alone, if so wanted."""
    from pftwin.geometry.patch.tessellate import points_and_normals

    points, _ = points_and_normals(surface.unstacked(), *np.meshgrid(u, v, indexing="ij"))
    k = np.arange(u.size * v.size).reshape(u.size, v.size)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    cells = np.ones(a.shape, dtype=bool)
    if outside:
        inside = [_within(x, *ends) for x, ends in zip((u, v), _rectangle(surface), strict=True)]
        cells = ~np.logical_and.outer(*inside)
    faces = np.stack([a[cells], b[cells], c[cells], a[cells], c[cells], d[cells]], axis=1).reshape(-1, 3)
    used, which = np.unique(faces, return_inverse=True)
    return points.reshape(-1, 3)[used], which.reshape(-1, 3)


def _within(lines: NDArray[np.float64], low: float, high: float) -> NDArray[np.bool_]:
    """Which intervals between grid lines lie between two of them."""
    middle = 0.5 * (lines[1:] + lines[:-1])
    return (middle > low) & (middle < high)
