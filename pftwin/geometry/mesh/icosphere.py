"""Icospheres: triangle meshes of a sphere, also in the resolutions of Michaud et al. 2024.

Michaud et al. 2024 compare a coarse mesh (CM: deviation 0.1 mm, angle 1 deg) and a fine one (FM: 0.006 mm, 0.5 deg).
The paper does not define the angle. It cannot have set the resolution: a button whose adjacent triangles differ by
1 deg deviates by only a fiftieth of 0.1 mm. The reported times agree with the deviations: a step took 27 times as long
with FM as with CM; meshes with these deviations differ 17-fold in triangles, with these angles 4-fold. So CM and FM
are defined here by their deviations.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import MESH_TRIANGLES
from pftwin.geometry.mesh.mesh import SurfaceMesh, weld

RESOLUTIONS = {"CM": 0.1e-3, "FM": 0.006e-3}  # largest deviation of the mesh from the surface [m]
_MOST_FREQUENCY = 300  # 1.8 million triangles


def icosphere(radius: float, frequency: int) -> SurfaceMesh:
    """An icosphere of 20 * frequency^2 outward triangles, its vertices on a sphere of a radius [m] about the origin.

    A frequency of 16 gives 5,120 triangles, the same as four subdivisions of the icosahedron. Raises InputError for a
    frequency below 1 or that gives too many triangles, and a radius that is not positive.
    """
    if not frequency >= 1 or 20 * frequency**2 > MESH_TRIANGLES:
        raise InputError(f"found {frequency}", where="frequency", expected=f"1 to {int((MESH_TRIANGLES / 20) ** 0.5)}")
    if not (np.isfinite(radius) and radius > 0):
        raise InputError(f"found {radius}", where="radius", expected="a positive length")
    vertices, faces = _unit(frequency)
    return SurfaceMesh(radius * vertices, faces, f"icosphere, {len(faces)} triangles")


def icosphere_deviation(frequency: int) -> float:
    """Largest distance of an icosphere from its sphere, in radii."""
    vertices, faces = _unit(frequency)
    mesh = SurfaceMesh(vertices, faces)
    normals = mesh.area_vectors / mesh.face_areas[:, None]
    inward = 1 - np.einsum("ij,ij->i", normals, vertices[faces[:, 0]])  # a face is nearest at its normal's foot
    return float(inward.max())


def button_mesh(radius: float, deviation: float) -> SurfaceMesh:
    """The coarsest icosphere within a deviation [m] of a sphere of a radius [m] about the origin.

    Raises InputError for a radius or deviation that is not positive, or that needs more triangles than a mesh may have.
    """
    for name, value in (("radius", radius), ("deviation", deviation)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"found {value}", where=name, expected="a positive number")
    # The first guess assumes a hexagonal net on the sphere; the icosphere's own deviation decides.
    for frequency in range(max(1, math.floor(0.5 * math.sqrt(radius / deviation))), _MOST_FREQUENCY + 1):
        if radius * icosphere_deviation(frequency) <= deviation:
            return icosphere(radius, frequency)
    raise InputError(f"more than {20 * _MOST_FREQUENCY**2} triangles", where="deviation", remedy="a coarser one")


@lru_cache(maxsize=8)
def _unit(frequency: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    corners, base = _icosahedron()
    i, j = (g.ravel() for g in np.meshgrid(*[np.arange(frequency + 1)] * 2, indexing="ij"))
    inside = i + j <= frequency
    number = np.full((frequency + 1, frequency + 1), -1)
    i, j = i[inside], j[inside]
    number[i, j] = np.arange(len(i))
    up, down = i + j < frequency, i + j < frequency - 1
    corners_up = number[i[up], j[up]], number[i[up] + 1, j[up]], number[i[up], j[up] + 1]
    i_down, j_down = i[down], j[down]
    corners_down = number[i_down + 1, j_down], number[i_down + 1, j_down + 1], number[i_down, j_down + 1]
    face = np.concatenate([np.stack(corners_up, axis=1), np.stack(corners_down, axis=1)])
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
