"""Tessellation of a smooth surface over a chart to a given deviation; runs on the host.

The grid lines u = const and v = const are spaced by the curvature along them (a chord of length s on a curve of
curvature k deviates by s^2 k / 8 and turns by s k). The mesh is then compared with the surface between its vertices and
refined until it is within the deviation.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.closest import rectangle_of
from pftwin.geometry.patch.implant import FemoralComponent

_LONGEST = 5e-3  # largest grid spacing [m]
_SAMPLES = 241  # samples of the curvature along u and v
_MOST_TRIANGLES = 2_000_000
_INSIDE = ((0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (1 / 3, 1 / 3))  # points of a triangle where the deviation is sampled


def tessellate(surface: FemoralComponent, *, deviation: float, angle: float | None = None) -> SurfaceMesh:
    """Meshes a surface over its rectangle (`center`, `half_size`); arguments and errors as `FemoralComponent.mesh`."""
    if not (math.isfinite(deviation) and deviation > 0):
        raise InputError(f"a deviation of {deviation} m", where="deviation", expected="a positive length, e.g. 0.1e-3")
    if angle is not None and not 0 < angle < math.pi / 2:
        raise InputError(f"an angle of {angle} rad", where="angle", expected="between 0 and pi/2 rad")
    samples = [np.linspace(*ends, _SAMPLES) for ends in rectangle_of(surface)]
    densities = _densities(surface, samples, deviation, angle)
    for _ in range(8):
        u, v = (_spaced(s, d) for s, d in zip(samples, densities, strict=True))
        if 2 * len(u) * len(v) > _MOST_TRIANGLES:
            raise InputError(
                f"{2 * len(u) * len(v)} triangles",
                where="deviation, angle",
                expected=f"at most {_MOST_TRIANGLES}",
                remedy="coarser tolerances",
            )
        mesh, worst = _mesh(surface, u, v)
        if worst <= deviation:
            return mesh
        densities = [d * max(1.05, math.sqrt(worst / deviation)) for d in densities]
    raise InputError(
        f"the surface cannot be meshed to {deviation} m: {worst:.3g} m reached", remedy="a coarser deviation"
    )


def points_and_normals(
    surface: FemoralComponent, u: NDArray, v: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points [m] and unit normals, (..., 3) each, in the femur's frame at arrays of u and v [m] of one shape.

    Arrays are padded so that meshes of many sizes share a few compiled programs.
    """
    n = u.size
    padded = 1 << max(12, (n - 1).bit_length())
    points, normals = _point_and_normal(surface, *(jnp.asarray(np.resize(x.ravel(), padded)) for x in (u, v)))
    return tuple(np.asarray(a, dtype=np.float64)[:n].reshape(*u.shape, 3) for a in (points, normals))  # pyright: ignore[reportReturnType]


@jax.jit
def _point_and_normal(surface: FemoralComponent, u: Any, v: Any) -> tuple[Any, Any]:
    """Points and unit normals, each (n, 3)."""
    jet = surface.jet(u, v)
    normal = surface.chart.axes.apply(surface.chart.normal(u, jet.f, jet.u, jet.v))
    return surface.chart.point(u, v, jet.f).array(), normal.array()


def _densities(
    surface: FemoralComponent, samples: list[NDArray], deviation: float, angle: float | None
) -> list[NDArray[np.float64]]:
    """Grid lines per metre at the samples along u and along v."""
    u, v = np.meshgrid(*samples, indexing="ij")
    points, normals = points_and_normals(surface, u, v)
    result = []
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(points, axis=axis), axis=2)
        turn = np.linalg.norm(np.diff(normals, axis=axis), axis=2)
        curvature = (turn / step).max(axis=1 - axis)
        stretch = (step / np.diff(samples[axis])[:, None].reshape((-1, 1) if axis == 0 else (1, -1))).max(axis=1 - axis)
        per_metre = np.maximum(np.sqrt(curvature / (4 * deviation)), 1 / _LONGEST)  # half the deviation per direction
        if angle is not None:
            per_metre = np.maximum(per_metre, curvature / angle)
        result.append(per_metre * stretch)
    return result


def _spaced(samples: NDArray, density: NDArray) -> NDArray[np.float64]:
    """Positions of grid lines between the ends, with at least the given density between samples."""
    total = np.concatenate([[0.0], np.cumsum(density * np.diff(samples))])
    return np.interp(np.linspace(0, total[-1], math.ceil(total[-1]) + 1), total, samples)


def _mesh(surface: FemoralComponent, u: NDArray, v: NDArray) -> tuple[SurfaceMesh, float]:
    """Mesh of the grid, and the largest sampled distance between it and the surface [m]."""
    grid = np.meshgrid(u, v, indexing="ij")
    points, _ = points_and_normals(surface, grid[0].ravel(), grid[1].ravel())
    k = np.arange(len(u) * len(v)).reshape(len(u), len(v))
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    odd = (np.add.outer(np.arange(len(u) - 1), np.arange(len(v) - 1)).ravel() % 2 == 1)[:, None, None]
    first = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1)
    second = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], 1)
    faces = np.where(odd, second, first).reshape(-1, 3)  # diagonals alternate: no preferred direction
    worst = 0.0
    for s, t in _INSIDE:
        inside, *uv = (
            (1 - s - t) * x[faces[:, 0]] + s * x[faces[:, 1]] + t * x[faces[:, 2]]
            for x in (points, grid[0].ravel(), grid[1].ravel())
        )
        on, normal = points_and_normals(surface, *uv)
        gap = np.einsum("ij,ij->i", inside - on, normal)
        worst = max(worst, float(np.abs(gap).max()))
    return SurfaceMesh(points, faces, f"parametric femoral component, {len(faces)} triangles"), worst
