"""A sphere of triangles: the icosahedron's faces divided evenly and pushed out to the sphere."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import MESH_TRIANGLES
from pftwin.geometry.mesh.mesh import SurfaceMesh, weld


def icosphere(radius: float, frequency: int) -> SurfaceMesh:
    """20 * frequency^2 triangles with their corners on a sphere about the origin, outward.

    A frequency of 16 is the sphere with 5,120 triangles that four halvings of the icosahedron's edges give.

    Raises:
        InputError: a frequency below 1 or that makes too many triangles; a radius that is not positive.
    """
    if not frequency >= 1 or 20 * frequency**2 > MESH_TRIANGLES:
        raise InputError(f"found {frequency}", where="frequency", expected=f"1 to {int((MESH_TRIANGLES / 20) ** 0.5)}")
    if not (np.isfinite(radius) and radius > 0):
        raise InputError(f"found {radius}", where="radius", expected="a positive length")
    vertices, faces = _unit(frequency)
    return SurfaceMesh(radius * vertices, faces, f"icosphere, {len(faces)} triangles")


def icosphere_deviation(frequency: int) -> float:
    """The largest distance of an icosphere from its sphere, in radii."""
    vertices, faces = _unit(frequency)
    mesh = SurfaceMesh(vertices, faces)
    normals = mesh.area_vectors / mesh.face_areas[:, None]
    inward = 1 - np.einsum("ij,ij->i", normals, vertices[faces[:, 0]])  # a face is nearest where its normal passes
    return float(inward.max())


@lru_cache(maxsize=8)
def _unit(frequency: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    corners, base = _icosahedron()
    i, j = (g.ravel() for g in np.meshgrid(*[np.arange(frequency + 1)] * 2, indexing="ij"))
    inside = i + j <= frequency
    number = np.full((frequency + 1, frequency + 1), -1)
    i, j = i[inside], j[inside]
    number[i, j] = np.arange(len(i))
    up, down = i + j < frequency, i + j < frequency - 1
    faces = [
        np.stack([number[a, b] for a, b in places], axis=1)
        for places in (
            ((i[up], j[up]), (i[up] + 1, j[up]), (i[up], j[up] + 1)),
            ((i[down] + 1, j[down]), (i[down] + 1, j[down] + 1), (i[down], j[down] + 1)),
        )
    ]
    face = np.concatenate(faces)
    s, t = (i / frequency)[:, None], (j / frequency)[:, None]
    points = [corners[a] + s * (corners[b] - corners[a]) + t * (corners[c] - corners[a]) for a, b, c in base]
    every = np.concatenate([face + k * len(i) for k in range(20)])
    vertices, joined = weld(np.concatenate(points), every)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), joined


def _icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Unit vertices (12, 3) and outward faces (20, 3)."""
    from scipy.spatial import ConvexHull

    golden = 0.5 * (1 + 5**0.5)
    edge = np.array([(0.0, s, t * golden) for s in (-1, 1) for t in (-1, 1)])
    corners = np.concatenate([np.roll(edge, k, axis=1) for k in range(3)]) / np.hypot(1, golden)
    faces = ConvexHull(corners).simplices.astype(np.int64)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    return corners, np.where(inward[:, None], faces[:, ::-1], faces)
