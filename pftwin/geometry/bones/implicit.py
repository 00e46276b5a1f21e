"""Closed triangle meshes of smooth bodies given as implicit functions (positive inside).

Surface nets (Gibson 1998, MERL TR 98-11) on a regular grid: one vertex in each cube that the surface crosses, and one
quadrilateral across each grid edge whose ends are on different sides. The vertices are then moved onto the surface by
Newton's method along the gradient, so that only the triangles' size limits the accuracy.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import SurfaceMesh

Body = Callable[[Floats], Floats]  # (n, 3) [mm] -> (n,) [mm], positive inside

_CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
_STEP = 1e-3  # step of central differences [mm]
_NEWTON_STEPS = 8
_LONGEST = 0.5  # longest Newton step, in grid spacings
_CLOSE = 1e-5  # tolerance of vertices on the surface [mm]


def smallest(*values: Floats, blend: float) -> Floats:
    """Smooth minimum, the intersection of bodies; at most `blend` * log(number of bodies) below the minimum."""
    least = np.min(values, axis=0)
    return least - blend * np.log(np.sum([np.exp((least - v) / blend) for v in values], axis=0))


def largest(*values: Floats, blend: float) -> Floats:
    """Smooth maximum, the union of bodies."""
    return -smallest(*(-v for v in values), blend=blend)


def smooth_step(x: Floats) -> Floats:
    """Smooth step from 0 (x below 0) to 1 (x above 1), with continuous second derivative."""
    t = np.clip(x, 0.0, 1.0)
    return t**3 * (10 - 15 * t + 6 * t * t)


def mesh_of(body: Body, low: tuple[float, ...], high: tuple[float, ...], spacing: float, source: str) -> SurfaceMesh:
    """Meshes the surface of a body; the mesh is closed, in metres, its triangles about as large as the spacing.

    Args:
        body: implicit function, positive inside, smooth near the surface [mm].
        low, high: corners of a box that contains the body with a margin [mm].
        spacing: edge of the grid's cubes [mm].
        source: name of the mesh.

    Raises:
        InputError: a body that extends beyond the box, or that has details too fine for the spacing.
    """
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    value = body(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    inside = value > 0
    if inside[[0, -1]].any() or inside[:, [0, -1]].any() or inside[:, :, [0, -1]].any() or not inside.any():
        raise InputError("the body does not fit in its box", where=source)
    vertices, number = _vertices(value, inside, axes, spacing)
    faces = _faces(inside, number)
    mesh = SurfaceMesh(_projected(body, vertices, spacing) * 1e-3, faces, source)
    if not mesh.is_closed:
        raise InputError(
            f"a spacing of {spacing:g} mm is too coarse for it", where=source, remedy="a finer resolution_mm"
        )
    return mesh


def _vertices(
    value: Floats, inside: NDArray[np.bool_], axes: list[Floats], spacing: float
) -> tuple[Floats, NDArray[np.int64]]:
    """One vertex per crossed cube, the mean of its edges' crossing points; and each cube's vertex number, or -1."""
    shape = tuple(n - 1 for n in inside.shape)
    corner = [value[tuple(slice(c, c + n) for c, n in zip(place, shape, strict=True))] for place in _CORNERS]
    total, count = np.zeros((*shape, 3)), np.zeros(shape)
    for a, b in combinations(range(8), 2):
        if np.abs(_CORNERS[a] - _CORNERS[b]).sum() != 1:
            continue  # not an edge of the cube
        crossed = (corner[a] > 0) != (corner[b] > 0)
        gap = np.where(crossed, corner[a] - corner[b], 1.0)
        at = _CORNERS[a] + (corner[a] / gap)[..., None] * (_CORNERS[b] - _CORNERS[a])
        total += np.where(crossed[..., None], at, 0.0)
        count += crossed
    found = np.argwhere(count > 0)
    number = np.full(shape, -1, dtype=np.int64)
    number[tuple(found.T)] = np.arange(len(found))
    middle = total[tuple(found.T)] / count[tuple(found.T)][:, None]
    return np.array([a[0] for a in axes]) + spacing * (found + middle), number


def _faces(inside: NDArray[np.bool_], number: NDArray[np.int64]) -> NDArray[np.int64]:
    """Two triangles for each crossed grid edge, counter-clockwise seen from outside."""
    faces = []
    for axis in range(3):
        other = [(axis + 1) % 3, (axis + 2) % 3]
        first, second = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
        edges = np.argwhere(np.moveaxis(first != second, 0, axis))
        leaving = inside[tuple(edges.T)]  # from inside to outside along the axis
        around = []
        for da, db in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            cube = edges.copy()
            cube[:, other[0]] += da
            cube[:, other[1]] += db
            around.append(number[tuple(cube.T)])
        quad = np.stack(around, axis=1)
        quad = np.where(leaving[:, None], quad, quad[:, ::-1])
        faces += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    return np.concatenate(faces)


def _projected(body: Body, points: Floats, spacing: float) -> Floats:
    """Moves points onto the surface along its normals."""
    for _ in range(_NEWTON_STEPS):
        value = body(points)
        if np.abs(value).max() < _CLOSE:
            break
        slope = gradient(body, points)
        step = -(value / np.maximum((slope**2).sum(axis=1), 1e-12))[:, None] * slope
        size = np.linalg.norm(step, axis=1, keepdims=True)
        points = points + step * np.minimum(1.0, _LONGEST * spacing / np.maximum(size, 1e-12))
    return points


def gradient(body: Body, points: Floats) -> Floats:
    """Gradient (n, 3) of a body's function by central differences."""
    change = [body(points + _STEP * e) - body(points - _STEP * e) for e in np.eye(3)]
    return np.stack(change, axis=1) / (2 * _STEP)
