"""Triangles that add nothing to a surface: those without area, and those that are there already."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import COINCIDENT


def zero_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which triangles are no higher over their longest side than vertices of the mesh may be apart and yet be one."""
    p = vertices[faces]
    sides = np.roll(p, -1, axis=1) - p
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    extent = float(np.ptp(p.reshape(-1, 3), axis=0).max())
    return twice <= COINCIDENT * extent * longest


def repeated(faces: NDArray[np.int64], looked_at: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Of the triangles looked at, (m,): copies of an earlier one that runs the same way, and those on their reverse."""
    first = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)  # smallest vertex first
    places = np.flatnonzero(looked_at)
    copies, opposed = np.zeros((2, len(faces)), dtype=bool)
    _, at, group = np.unique(turned[places], axis=0, return_index=True, return_inverse=True)
    copies[places] = at[group.ravel()] != np.arange(len(places))
    once = places[~copies[places]]
    _, sheet, count = np.unique(np.sort(turned[once], axis=1), axis=0, return_inverse=True, return_counts=True)
    opposed[once] = count[sheet.ravel()] > 1
    return copies, opposed
