"""Meshes to draw [mm], and the 4 x 4 model matrices that move them; poses and meshes of scenes are in metres."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.arrays import Floats

MM = 1e3  # per metre
Moving = tuple[NDArray[np.float32], NDArray[np.uint32]]  # vertices (n, v, 3) [mm] at n frames, triangles (m, 3)
Matrices = NDArray[np.float32]  # (n, 4, 4), row by row, lengths in mm
ROUND = 48  # sides of a round shape
MOST_TRIANGLES = 30_000  # of a drawn mesh, which keeps a page far below 8 MB
CAP = np.radians(58.0)  # half opening angle of a button's dome
FEW = 4  # an effect with at most this many lines is drawn with thick lines
CLOSE = 12.0  # largest distance between neighbouring lines of a ribbon [mm]
THICKNESS = 2.0  # of a ribbon [mm]
SHELL = 5.0  # drawn thickness of a femoral component of which only the surface is known [mm]


def of_poses(position: ArrayLike, quaternion: ArrayLike) -> Matrices:
    """Returns matrices from positions (n, 3) [m] and unit quaternions (n, 4), scalar first."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(np.asarray(quaternion, dtype=np.float64), scalar_first=True)
    return _assembled(turn.as_matrix(), MM * np.asarray(position, dtype=np.float64))


def at_points(points: ArrayLike) -> Matrices:
    """Returns matrices from positions (n, 3) [m], without rotation."""
    points = np.asarray(points, dtype=np.float64)
    return _assembled(np.broadcast_to(np.eye(3), (len(points), 3, 3)), MM * points)


def of_arrows(tails: ArrayLike, arrows: ArrayLike) -> Matrices:
    """Returns matrices that scale and rotate the unit arrow along z to arrows (n, 3) [mm] at tails (n, 3) [m]."""
    arrows = np.asarray(arrows, dtype=np.float64)
    length = np.linalg.norm(arrows, axis=1)
    z = arrows / length[:, None]
    least = np.eye(3)[np.argmin(np.abs(z), axis=1)]  # the axis with the largest angle to the arrow
    x = np.cross(least, z)
    x /= np.linalg.norm(x, axis=1)[:, None]
    turn = np.stack([x, np.cross(z, x), z], axis=2)
    return _assembled(turn * length[:, None, None], MM * np.asarray(tails, dtype=np.float64))


def _assembled(turn: NDArray[np.float64], place: NDArray[np.float64]) -> Matrices:
    out = np.zeros((len(place), 4, 4), dtype=np.float32)
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = turn, place, 1.0
    return out


class Shape(NamedTuple):
    """A mesh to draw, in mm."""

    vertices: NDArray[np.float32]  # (n, 3) [mm]
    triangles: NDArray[np.uint32]  # (m, 3)


def as_shape(mesh: Any) -> Shape:
    """Converts a trimesh in mm to a shape."""
    return Shape(np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces, dtype=np.uint32))


def surface(mesh: tuple[NDArray[Any], NDArray[Any]], most: int = MOST_TRIANGLES) -> Shape:
    """Converts a mesh in metres to a shape with at most `most` triangles."""
    from trimesh import Trimesh

    drawn = Trimesh(MM * mesh[0], mesh[1], process=False)
    if len(drawn.faces) > most:
        drawn = drawn.simplify_quadric_decimation(face_count=most)
    return as_shape(drawn)


def shell(mesh: tuple[NDArray[Any], NDArray[Any]], thickness: float = SHELL) -> Shape:
    """Extrudes an open surface in metres by `thickness` [mm], against its normals, into a closed shell."""
    from trimesh import Trimesh
    from trimesh.grouping import group_rows

    top = Trimesh(MM * mesh[0], mesh[1], process=False)
    n = len(top.vertices)
    rim = top.edges[group_rows(top.edges_sorted, require_count=1)]
    a, b = rim.T
    sides = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    below = top.vertices - thickness * top.vertex_normals
    faces = np.concatenate([top.faces, top.faces[:, ::-1] + n, sides])
    return Shape(np.concatenate([top.vertices, below]).astype(np.float32), faces.astype(np.uint32))


def ellipsoid(center: ArrayLike, half: ArrayLike) -> Shape:
    """Returns an ellipsoid with half axes along x, y, z [mm]."""
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=3)
    ball.apply_scale(np.asarray(half, dtype=np.float64))
    ball.apply_translation(np.asarray(center, dtype=np.float64))
    return as_shape(ball)


def solid_of_revolution(profile: ArrayLike, center: ArrayLike) -> Shape:
    """Returns the solid of revolution of a closed profile about the axis along z through a point (3,) [mm].

    The profile is radius and height above that point (k, 2) [mm], from the lower end of the axis to the upper.
    """
    from trimesh.creation import revolve

    body = revolve(np.asarray(profile, dtype=np.float64), sections=ROUND)
    if body.volume < 0:
        body.invert()
    body.apply_translation(np.asarray(center, dtype=np.float64))
    return as_shape(body)


def button_cap(center: ArrayLike, radius: float) -> Shape:
    """Returns the part of a button's sphere (centre and radius in m) that faces the femur, along the patella's -z."""
    angle = np.linspace(0.0, CAP, 25)
    arc = MM * radius * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    return solid_of_revolution(np.concatenate([arc, [[0.0, arc[-1, 1]]]]), MM * np.asarray(center, dtype=np.float64))


def behind_plane(shape: Shape, z: float) -> Shape:
    """Returns the part of a button behind the plane z [mm], or all if that is empty: a whole ball hides the patella."""
    behind = shape.vertices[shape.triangles].mean(axis=1)[:, 2] <= z
    if not behind.any():
        return shape
    used, which = np.unique(shape.triangles[behind], return_inverse=True)
    return Shape(shape.vertices[used], which.reshape(-1, 3).astype(np.uint32))


def arrow_shape() -> Shape:
    """Returns an arrow of length 1 along z."""
    head, shaft, width = 0.24, 0.025, 0.075
    return solid_of_revolution([[0, 0], [shaft, 0], [shaft, 1 - head], [width, 1 - head], [0, 1]], np.zeros(3))


def tubes(lines: NDArray[np.float64], radius: float, sides: int) -> Moving:
    """Returns tubes along lines that move.

    Args:
        lines: k lines through m points at n frames (n, k, m, 3) [mm].
        radius: radius of the tubes [mm].
        sides: number of sides of each tube.

    Returns:
        Vertices (n, k m sides, 3) [mm] and triangles (2 k (m - 1) sides, 3), which are the same at every frame.
    """
    n, k, m, _ = lines.shape
    vertices = lines[..., None, :] + _rings(directions(lines), radius, sides)
    a = np.arange(k * m * sides).reshape(k, m, sides)
    faces = ring_triangles(a[:, :-1].reshape(-1, sides), a[:, 1:].reshape(-1, sides)).reshape(-1, 3)
    return vertices.reshape(n, -1, 3).astype(np.float32), faces.astype(np.uint32)


def directions(lines: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit directions of lines (..., m, 3) at their points: the mean of those of both pieces that meet there."""
    pieces = units(np.diff(lines, axis=-2))
    both = pieces[..., :-1, :] + pieces[..., 1:, :]
    return units(np.concatenate([pieces[..., :1, :], both, pieces[..., -1:, :]], axis=-2))


def units(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (..., 3); zero for zero vectors."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)


def path(points: NDArray[np.float64], radius: float, sides: int = 6) -> Shape:
    """Returns a tube along points (n, 3) [mm] with a ring of vertices at each; NaN points leave gaps."""
    there = np.isfinite(points).all(axis=1)
    p = points[there]
    along = np.asarray(np.gradient(p, axis=0)) if len(p) > 1 else np.ones_like(p)
    vertices = p[:, None] + _rings(along[None, None], radius, sides)[0, 0]
    k = np.arange(len(p) * sides).reshape(len(p), sides)
    whole = np.diff(np.cumsum(~there)[there]) == 0
    faces = ring_triangles(k[:-1], k[1:])[whole].reshape(-1, 3)
    return Shape(vertices.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32))


def spaced_points(points: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Selects finite points (n, 3) at least `least` from the last selected one; returns a mask (n,)."""
    taken, last = np.zeros(len(points), dtype=bool), (math.inf, math.inf, math.inf)
    there = np.flatnonzero(np.isfinite(points).all(axis=1))
    for i, point in zip(there.tolist(), points[there].tolist(), strict=True):  # ten times faster than with arrays
        if math.dist(point, last) >= least:
            taken[i], last = True, point
    return taken


def _rings(along: NDArray[np.float64], radius: float, sides: int) -> NDArray[np.float64]:
    """Circles perpendicular to directions along k lines (n, k, m, 3), (n, k, m, sides, 3) [mm].

    They do not jump about a line, from point to point or from frame to frame.
    """
    z = units(along)
    # For each line, the coordinate axis that it is never nearly along.
    reference = np.eye(3)[np.argmin(np.abs(z).max(axis=(0, 2)), axis=-1)]
    x = units(np.cross(z, reference[:, None]))
    y = np.cross(z, x)
    angle = (2 * np.pi / sides * np.arange(sides))[:, None]
    return radius * (np.cos(angle) * x[..., None, :] + np.sin(angle) * y[..., None, :])


def ring_triangles(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns triangles (k, sides, 2, 3) that join rings of vertices (k, sides)."""
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    return np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)


def line_shape(lines: Floats, radius: float) -> Moving:
    """Returns the shape of one effect's k lines through m points at n frames (n, k, m, 3), of a radius [m]."""
    paths = MM * lines
    order = _side_by_side(paths[0])
    if order is not None:
        return ribbon(paths[:, order], THICKNESS)
    return tubes(paths, MM * radius, 10 if paths.shape[1] <= FEW else 5)


def ribbon(lines: Floats, thickness: float) -> Moving:
    """Returns a sheet through lines that move.

    Args:
        lines: k lines through m points at n frames, in order across the ribbon (n, k, m, 3) [mm].
        thickness: thickness of the sheet [mm].
    """
    n, k, m, _ = lines.shape
    across = np.asarray(np.gradient(lines.mean(axis=2), axis=1))
    half = 0.5 * thickness * units(np.cross(directions(lines), across[:, :, None]))
    rings = np.concatenate([lines + half, (lines - half)[:, :, ::-1]], axis=2)  # (n, k, 2 m, 3)
    at = np.arange(k * 2 * m).reshape(k, 2 * m)
    a = np.arange(m - 1)
    b, c, d = a + 1, 2 * m - 2 - a, 2 * m - 1 - a
    edge = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    faces = np.concatenate([ring_triangles(at[1:], at[:-1]).reshape(-1, 3), at[0, ::-1][edge], at[-1][edge]])
    return rings.reshape(n, -1, 3).astype(np.float32), faces.astype(np.uint32)


def _side_by_side(lines: Floats) -> NDArray[np.int64] | None:
    """Order across the ribbon (k,) of lines (k, m, 3) [mm] with neighbouring ends close together; otherwise None."""
    if len(lines) < 3:
        return None
    ends = lines[:, [0, -1]]
    middle = ends.sum(axis=1) - ends.sum(axis=1).mean(axis=0)
    order = np.argsort(middle @ np.linalg.svd(middle)[2][0])
    gaps = np.linalg.norm(np.diff(ends[order], axis=0), axis=-1)
    return order if gaps.max() < CLOSE else None
