"""Fits a sphere to a patellar button: centre, radius, and extent of the spherical dome."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.mesh import SurfaceMesh

_RING = 40  # smallest number of vertices in a ring
_FLAT = 5.0  # largest radius of a dome, as a multiple of the mesh's size


@dataclass(frozen=True, eq=False)
class SphereFit:
    """A sphere fitted to a button, in the mesh's frame; lengths in metres, angles in radians.

    `rms` and `max_error` are over the dome (the cap): the part around the apex whose rings of vertices are within the
    tolerance. Beyond the dome the surface is not this sphere.
    """

    center: NDArray[np.float64]  # (3,)
    radius: float
    axis: NDArray[np.float64]  # (3,) unit, from the center to the apex
    rms: float
    max_error: float
    cap_half_angle: float  # pi for a whole sphere
    cap_radius: float  # largest distance of the dome from the axis; the sphere's radius for a hemisphere or more
    n_vertices: int  # in the cap
    tolerance: float

    def __str__(self) -> str:
        return (
            f"sphere of radius {1e3 * self.radius:.3f} mm within {1e3 * self.cap_radius:.1f} mm of its axis, "
            f"rms {1e6 * self.rms:.1f} um, max {1e6 * self.max_error:.1f} um, {self.n_vertices} vertices"
        )


def fit_sphere(mesh: SurfaceMesh, *, tolerance: float = 0.02e-3, axis: ArrayLike | None = None) -> SphereFit:
    """Fits a sphere to the domed part of a patellar button, and finds the edge of the dome.

    The dome grows ring by ring from the apex while a sphere fits every ring to an rms within `tolerance`. The sphere is
    then fitted to the inner four fifths of the dome, so that a flare at the edge does not affect the radius, and the
    dome's edge is where the rings deviate from that sphere.

    Args:
        mesh: the button, normals outward; only its spherical dome matters.
        tolerance: largest rms error of a ring of the dome [m]; increase it for noisy scans.
        axis: direction from the button's middle to its apex, (3,). None: the mean normal of an open mesh; for a closed
            mesh the principal direction with the largest dome.

    Raises:
        InputError: no spherical dome, or one that is too small or concave; an invalid axis or tolerance.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"a tolerance of {tolerance} m", where="tolerance", expected="a positive length, e.g. 0.02e-3")
    direction = _axis(mesh, axis, tolerance)
    points, normals = mesh.vertices, mesh.vertex_normals
    center, radius = _sphere(points)
    if _residual_rms(points, center, radius) <= tolerance:
        _check_dome(mesh, np.arange(len(points)), center, radius)
        return _report(mesh, np.ones(len(points), dtype=bool), center, radius, direction, tolerance)
    order, rings = _rings(points, normals, direction)
    if len(rings) < 3:
        raise InputError(
            f"only {len(order)} vertices on the apex's side", where=mesh.source, expected=f"{3 * _RING} or more"
        )
    end = _largest_spherical_cap(points[order], rings, tolerance)
    if end < 2 * _RING:
        found = _residual_rms(points[order[: 2 * _RING]], *_sphere(points[order[: 2 * _RING]]))
        raise InputError(
            f"no spherical cap: the {2 * _RING} vertices about the apex are off a sphere by {found * 1e6:.1f} um rms",
            where=mesh.source,
            expected=f"a dome that is a sphere within {tolerance * 1e6:.1f} um",
            remedy="a larger tolerance=, or axis= if the apex is on another side",
        )
    inner = order[: max(2 * _RING, int(0.64 * end))]  # four fifths of its radius: the count grows with the square
    center, radius = _sphere(points[inner])
    _check_dome(mesh, inner, center, radius)
    ring_rms = [_residual_rms(points[order[a:b]], center, radius) for a, b in rings]
    inside = next((k for k, value in enumerate(ring_rms) if value > tolerance), len(rings))
    cap = np.zeros(len(points), dtype=bool)
    cap[order[: rings[max(inside, 1) - 1][1]]] = True
    return _report(mesh, cap, center, radius, direction, tolerance)


def _check_dome(mesh: SurfaceMesh, cap: NDArray, center: NDArray, radius: float) -> None:
    """Raises InputError for a sphere that is too large (flat), or a concave dome."""
    if radius > _FLAT * mesh.extent:
        found = f"the apex's side is flat (a sphere of radius {radius:.2g} m)"
        raise InputError(found, where=mesh.source, remedy="axis= if the apex is on another side")
    if not np.einsum("ij,ij->", mesh.vertices[cap] - center, mesh.vertex_normals[cap]) > 0:
        raise InputError(
            "the cap is hollow, or its normals point inward", where=mesh.source, remedy="mesh.flipped(), or axis="
        )


def _axis(mesh: SurfaceMesh, axis: ArrayLike | None, tolerance: float) -> NDArray[np.float64]:
    """Unit direction towards the apex."""
    if axis is not None:
        d = np.asarray(axis, dtype=np.float64)
        if d.shape != (3,) or not np.isfinite(d).all() or not np.linalg.norm(d) > 0:
            raise InputError(f"{d} is not a direction", where="axis", expected="three numbers, not all zero")
        return d / np.linalg.norm(d)
    d = mesh.area_vectors.sum(axis=0)
    if np.linalg.norm(d) > 1e-3 * mesh.area:
        return d / np.linalg.norm(d)
    principal = np.linalg.eigh(np.cov(mesh.vertices.T))[1].T
    candidates = [sign * direction for direction in principal for sign in (1.0, -1.0)]
    return max(candidates, key=lambda direction: _cap_size(mesh, direction, tolerance))


def _cap_size(mesh: SurfaceMesh, direction: NDArray, tolerance: float) -> int:
    """Number of vertices of the convex dome about a direction; 0 for a flat or concave side."""
    order, rings = _rings(mesh.vertices, mesh.vertex_normals, direction)
    end = _largest_spherical_cap(mesh.vertices[order], rings, tolerance)
    if not end:
        return 0
    center, radius = _sphere(mesh.vertices[order[:end]])
    convex = np.einsum("ij,ij->", mesh.vertices[order[:end]] - center, mesh.vertex_normals[order[:end]]) > 0
    return end if convex and radius < _FLAT * mesh.extent else 0


def _rings(points: NDArray, normals: NDArray, direction: NDArray) -> tuple[NDArray[np.int64], list[tuple[int, int]]]:
    """Vertices that face the apex's side, ordered by distance from the apex, and the limits of rings in this order."""
    side = np.flatnonzero(normals @ direction > 0.2)
    if not side.size:
        return side, []
    middle = np.average(points[side], axis=0, weights=np.clip(normals[side] @ direction, 0, None) ** 8)
    height = (points[side] - middle) @ direction
    off_axis = np.linalg.norm(points[side] - middle - height[:, None] * direction, axis=1)
    order = side[np.argsort(off_axis)]
    limits = np.linspace(0, len(order), max(len(order) // _RING, 1) + 1).astype(int)
    return order, list(zip(limits[:-1].tolist(), limits[1:].tolist(), strict=True))


def _largest_spherical_cap(ordered: NDArray, rings: list[tuple[int, int]], tolerance: float) -> int:
    """Number of the ordered vertices in the largest dome whose rings all fit the dome's own sphere."""
    end = 0
    for k in range(1, len(rings)):
        reached = rings[k][1]
        center, radius = _sphere(ordered[:reached])
        last, whole = ordered[rings[k][0] : reached], ordered[:reached]
        if max(_residual_rms(last, center, radius), _residual_rms(whole, center, radius)) > tolerance:
            break
        end = reached
    return end


def _sphere(points: NDArray) -> tuple[NDArray[np.float64], float]:
    """Least-squares sphere: algebraic fit, then Gauss-Newton on the geometric distances."""
    shift = points.mean(axis=0)
    scale = max(float(np.abs(points - shift).max()), 1e-30)
    q = (points - shift) / scale
    system = np.column_stack([2 * q, np.ones(len(q))])
    solution, _, rank, _ = np.linalg.lstsq(system, (q * q).sum(axis=1), rcond=1e-9)
    if rank < 4:  # coplanar points: an infinite sphere
        normal = np.linalg.svd(q - q.mean(axis=0), full_matrices=False)[2][2]
        return shift + 1e6 * scale * normal, 1e6 * scale
    center, radius = solution[:3], float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0)))
    for _ in range(5):
        arm = q - center
        distance = np.linalg.norm(arm, axis=1)
        rows = np.column_stack([arm / distance[:, None], np.ones(len(q))])
        step = np.linalg.lstsq(rows, distance - radius, rcond=None)[0]
        center, radius = center + step[:3], radius + float(step[3])
    return center * scale + shift, radius * scale


def _residual_rms(points: NDArray, center: NDArray, radius: float) -> float:
    return float(np.sqrt(np.mean((np.linalg.norm(points - center, axis=1) - radius) ** 2)))


def _report(
    mesh: SurfaceMesh, cap: NDArray[np.bool_], center: NDArray, radius: float, direction: NDArray, tolerance: float
) -> SphereFit:
    """The result, with errors over the dome and the dome's size."""
    arm = mesh.vertices[cap] - center
    error = np.linalg.norm(arm, axis=1) - radius
    half_angle = float(np.arccos(np.clip(arm @ direction / np.linalg.norm(arm, axis=1), -1, 1)).max())
    if mesh.is_closed and cap.all():
        half_angle = np.pi
    return SphereFit(
        center,
        radius,
        direction,
        rms=float(np.sqrt(np.mean(error**2))),
        max_error=float(np.abs(error).max()),
        cap_half_angle=half_angle,
        cap_radius=radius * np.sin(min(half_angle, np.pi / 2)),
        n_vertices=int(cap.sum()),
        tolerance=tolerance,
    )
