"""The trochlear region of a femoral component, found on its mesh: axis, groove line, vertices, charts, directions.

The axis is that of the surface of revolution that best fits the component's anterior and distal surface (the line
nearest to the surface's normal lines, after Pottmann and Randrup 1998), moved so that a circle about it fits the bottom
of the groove. The groove line has the deepest point at each angle about the axis. The region is a rectangle in this
angle and in the medial-lateral distance from the groove line's middle; its vertices' normals point away from the axis.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array, number, vector
from pftwin.base.spatial import Rotation
from pftwin.base.written_amounts import AXES
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import CylindricalChart, PlaneChart
from pftwin.geometry.patch.groove import CHECK_DIRECTIONS, deepest_points, fit_axis_direction, fit_circle

Pair = tuple[float, float]
FACING = 0.4  # smallest cosine between a vertex's normal and the direction away from the axis


@dataclass(frozen=True, eq=False)
class TrochlearRegion:
    """The trochlear region of a mesh, in the mesh's own frame; lengths in metres, angles in radians.

    The charts' axes are x proximal, y lateral for a right knee, z anterior (the plane chart's rotated about y to the
    middle of the arc). Angles are about the axis, 0 anteriorly, positive proximally.
    """

    mask: NDArray[np.bool_]  # (n,) which vertices are in the region
    groove: NDArray[np.float64]  # (k, 3) groove line, from distal to proximal
    groove_depth: NDArray[np.float64]  # (k,) below the lower of the two facets, within the half width
    angles: tuple[float, float]  # of the rectangle
    half_width: float  # of the rectangle
    plane: PlaneChart
    cylinder: CylindricalChart
    source: str = "mesh"

    @property
    def n_vertices(self) -> int:
        """Number of vertices in the region."""
        return int(self.mask.sum())


def trochlear_region(
    mesh: SurfaceMesh,
    *,
    anterior: ArrayLike,
    proximal: ArrayLike,
    half_width: float = 0.02,
    angles: tuple[float, float] = (-math.pi / 3, math.pi / 3),
) -> TrochlearRegion:
    """Finds the trochlear region of a femoral component (or distal femur).

    Args:
        mesh: the surface, normals outward; open, or the whole closed part.
        anterior, proximal: these directions in the mesh's frame, (3,), accurate to some 20 deg.
        half_width: of the region, medial-lateral [m].
        angles: limits about the axis [rad]; the region ends earlier if the groove does.

    Raises:
        InputError: directions that are zero or nearly parallel; normals that point into the bone; no groove found.
    """
    hint = hinted_axes(anterior, proximal)
    if not half_width > 0 or not angles[0] < angles[1]:
        raise InputError(f"half_width {half_width}, angles {angles}", expected="a positive width, ascending angles")
    points, normals = mesh.vertices @ hint, mesh.vertex_normals @ hint
    check_outward(points, normals, mesh.source)
    center, _ = _seed(points, normals, mesh.source)
    turn = fit_axis_direction(points, normals, mesh.vertex_areas, center, mesh.source)
    if turn[1, 1] < math.cos(math.radians(25)):
        tilt = math.degrees(math.acos(turn[1, 1]))
        found = f"the surface's axis lies {tilt:.0f} deg from the medial-lateral direction of the hints"
        raise InputError(found, where=mesh.source, remedy=CHECK_DIRECTIONS)
    axes = hint @ turn
    points, normals = mesh.vertices @ axes, mesh.vertex_normals @ axes
    center, middle = _seed(points, normals, mesh.source)
    line, depth = _groove(points, normals, center, middle, half_width, angles, mesh.source)
    for _ in range(4):  # the deepest point depends on the axis, the axis on the deepest points
        x, y, z = _cartesian(line, center)
        center, middle = fit_circle(np.stack([x, z], axis=1))[0], float(np.median(y))
        line, depth = _groove(points, normals, center, middle, half_width, angles, mesh.source)
    step = float(np.median(np.diff(line[:, 0])))
    domain = max(angles[0], line[0, 0] - step / 2), min(angles[1], line[-1, 0] + step / 2)
    mask = _rectangle(points, normals, center, middle, domain, half_width)
    origin = axes @ np.array([center[0], middle, center[1]])
    groove = np.stack(_cartesian(line, center), axis=1) @ axes.T
    plane, cylinder = _charts(origin, axes, domain, float(np.median(line[:, 2])))
    return TrochlearRegion(mask, groove, depth, domain, half_width, plane, cylinder, mesh.source)


def region_about(
    mesh: SurfaceMesh, cylinder: CylindricalChart, *, angles: tuple[float, float], half_width: float
) -> TrochlearRegion:
    """The region about a known axis, the chart's y axis, without a search; otherwise like `trochlear_region`."""
    axes, origin = host_array(cylinder.axes), host_array(cylinder.origin)
    points, normals = (mesh.vertices - origin) @ axes, mesh.vertex_normals @ axes
    center = np.zeros(2)
    mask = _rectangle(points, normals, center, 0.0, angles, half_width)
    line, depth = _groove(points, normals, center, 0.0, half_width, angles, mesh.source)
    plane, _ = _charts(origin, axes, angles, float(np.median(line[:, 2])))
    groove = np.stack(_cartesian(line, center), axis=1) @ axes.T + origin
    return TrochlearRegion(mask, groove, depth, angles, half_width, plane, cylinder, mesh.source)


def hinted_axes(anterior: ArrayLike, proximal: ArrayLike) -> NDArray[np.float64]:
    """Orthonormal axes (3, 3), columns proximal, lateral (right knee) and anterior; `anterior` keeps its direction."""
    a, p = np.asarray(anterior, dtype=np.float64), np.asarray(proximal, dtype=np.float64)
    for name, d in (("anterior", a), ("proximal", p)):
        if d.shape != (3,) or not np.isfinite(d).all() or not np.linalg.norm(d) > 0:
            raise InputError(f"{d} is not a direction", where=name, expected="three numbers, not all zero")
    a, p = a / np.linalg.norm(a), p / np.linalg.norm(p)
    lateral = np.cross(a, p)
    if np.linalg.norm(lateral) < 0.5:
        found = f"anterior and proximal are {math.degrees(math.acos(np.clip(a @ p, -1, 1))):.0f} deg apart"
        raise InputError(found, where="anterior, proximal", expected="about 90 deg")
    lateral /= np.linalg.norm(lateral)
    return np.stack([np.cross(lateral, a), lateral, a], axis=1)


def check_outward(points: NDArray, normals: NDArray, source: str) -> None:
    """Raises InputError if the normals of the most anterior vertices point backward; (n, 3) in `hinted_axes`' axes."""
    front = points[:, 2] >= np.quantile(points[:, 2], 0.95)
    if normals[front, 2].mean() < 0:
        raise InputError(
            "the normals of the foremost vertices point backward",
            where=source,
            expected="normals out of the bone, and the anterior direction in the mesh's own frame",
            remedy="flip = true, mesh.flipped(), if the normals point into the bone; else check the anterior direction",
        )


def _seed(points: NDArray, normals: NDArray, source: str) -> tuple[NDArray, float]:
    """First guess of the axis's (x, z) and the groove's y: a circle through the middle strip, anterior and distal."""
    middle = float(points[:, 1].min() + points[:, 1].max()) / 2
    inner = points.mean(axis=0)
    outward = np.einsum("ij,ij->i", points - inner, normals) > 0
    faces = (normals[:, 2] > -0.2) & (normals[:, 0] < 0.6) & (np.abs(normals[:, 1]) < 0.8)
    strip = outward & faces & (np.abs(points[:, 1] - middle) < 6e-3)
    if strip.sum() < 20:
        found = f"only {strip.sum()} vertices in the middle of the part look forward or distally"
        raise InputError(found, where=source, remedy=f"{CHECK_DIRECTIONS}, or use a finer mesh")
    return fit_circle(points[strip][:, [0, 2]])[0], middle


def _groove(
    points: NDArray, normals: NDArray, center: NDArray, middle: float, half_width: float, angles: Pair, source: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """See `deepest_points`; raises InputError if there is no groove."""
    line, depth = deepest_points(points, normals, center, middle, half_width, angles)
    if len(line) < 5 or np.median(depth) < 0.3e-3:
        found = f"{1e3 * np.median(depth):.2f} mm deep over {len(line)} sections" if len(line) else "none at all"
        raise InputError(
            f"no trochlear groove found ({found})",
            where=source,
            expected="a groove at least 0.3 mm deep in five sections or more",
            remedy=f"{CHECK_DIRECTIONS}, and its units; in Python fit_patch takes a mask of your own as region=",
        )
    return line, depth


def _cartesian(line: NDArray, center: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """x, y, z from (angle, y, distance) about the axis."""
    angle, y, distance = line.T
    return center[0] + distance * np.sin(angle), y, center[1] + distance * np.cos(angle)


def _rectangle(
    points: NDArray, normals: NDArray, center: NDArray, middle: float, angles: tuple[float, float], half_width: float
) -> NDArray[np.bool_]:
    """Vertices in the rectangle of angle and y that face away from the axis."""
    x, z = points[:, 0] - center[0], points[:, 2] - center[1]
    angle = np.arctan2(x, z)
    facing = normals[:, 0] * np.sin(angle) + normals[:, 2] * np.cos(angle) > FACING
    inside = (angle >= angles[0]) & (angle <= angles[1]) & (np.abs(points[:, 1] - middle) <= half_width)
    return facing & inside


def _charts(
    origin: NDArray, axes: NDArray, angles: tuple[float, float], radius: float
) -> tuple[PlaneChart, CylindricalChart]:
    """A plane normal to the direction of the arc's middle, and a cylinder of the groove's radius."""
    tilt = 0.5 * (angles[0] + angles[1])
    c, s = math.cos(tilt), math.sin(tilt)
    turned = axes @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    at = vector(origin)
    return (
        PlaneChart(at, Rotation(*(vector(column) for column in turned.T))),
        CylindricalChart(at, Rotation(*(vector(column) for column in axes.T)), number(radius)),
    )


class Candidate(NamedTuple):
    """Directions, such as "-x", and the region that is found with them."""

    anterior: str
    proximal: str
    region: TrochlearRegion


def directions_with_groove(
    mesh: SurfaceMesh,
    *,
    half_width: float = 0.02,
    angles: tuple[float, float] = (-math.pi / 3, math.pi / 3),
    along: Mapping[str, ArrayLike] = AXES,
) -> list[Candidate]:
    """All pairs of directions along a mesh's axes, anterior and proximal, with which `trochlear_region` finds a groove.

    Pairs whose groove extends farthest distally come first, as a trochlea's does; then those with the longest groove.
    The shape alone does not determine the right pair: the notch of a bone is a groove too, and so is a trochlea upside
    down.

    Args:
        mesh, half_width, angles: as for `trochlear_region`.
        along: other directions to try, by name: unit vectors that are parallel or at right angles.
    """
    found = []
    for (anterior, ahead), (proximal, up) in itertools.permutations(along.items(), 2):
        if abs(np.dot(ahead, up)) > 0.5:
            continue  # the same axis
        try:
            region = trochlear_region(mesh, anterior=ahead, proximal=up, half_width=half_width, angles=angles)
        except InputError:
            continue  # no groove found
        found.append(Candidate(anterior, proximal, region))
    return sorted(found, key=lambda c: (round(c.region.angles[0], 3), -len(c.region.groove)))


class PrincipalAxis(NamedTuple):
    """One of the three principal axes."""

    direction: NDArray[np.float64]  # (3,) unit
    extent: float  # size of the mesh along it [the mesh's unit]


def principal_axes(mesh: SurfaceMesh) -> tuple[PrincipalAxis, ...]:
    """Eigenvectors of the surface's second moment of area about its centroid, right-handed, longest extent first.

    The largest component of each of the first two is positive.
    """
    corners, areas = mesh.vertices[mesh.faces], mesh.face_areas
    arms = corners - np.average(corners.mean(axis=1), axis=0, weights=areas)
    total = arms.sum(axis=1)
    # Exact for flat triangles: the integral of p p^T is area / 12 times this.
    moment = np.einsum("mki,mkj,m->ij", arms, arms, areas) + np.einsum("mi,mj,m->ij", total, total, areas)
    columns = np.linalg.eigh(moment)[1]
    directions = sorted(columns.T, key=lambda d: -np.ptp(mesh.vertices @ d))
    first, second = (d * np.sign(d[np.abs(d).argmax()]) for d in directions[:2])
    return tuple(PrincipalAxis(d, float(np.ptp(mesh.vertices @ d))) for d in (first, second, np.cross(first, second)))
