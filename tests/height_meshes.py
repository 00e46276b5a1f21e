"""Open meshes whose height is a function over a rectangle, for tests of contact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pftwin.geometry.mesh.mesh import SurfaceMesh


def level(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A plane's height: nought everywhere."""
    return 0.0 * u * v


def grid(
    heights: Callable[[np.ndarray, np.ndarray], np.ndarray], n: int = 41, half: tuple[float, float] = (0.03, 0.03)
) -> SurfaceMesh:
    """n by n vertices and 2 (n - 1)^2 triangles over a rectangle of these half sides [m], looking along z."""
    u, v = (g.ravel() for g in np.meshgrid(*(np.linspace(-h, h, n) for h in half), indexing="ij"))
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return SurfaceMesh(np.stack([u, v, heights(u, v)], axis=1), faces, "heights")


def plate(n: int = 24, half: float = 0.03) -> SurfaceMesh:
    """A flat square of 2 n^2 triangles."""
    return grid(level, n + 1, (half, half))


def lateral(mesh: SurfaceMesh) -> np.ndarray:
    """Which triangles lie at positive y."""
    return mesh.vertices[mesh.faces].mean(axis=1)[:, 1] > 0
