"""Poses as the 4 x 4 model matrices of a drawing: metres in, millimetres out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

MM = 1e3  # per metre
Matrices = NDArray[np.float32]  # (n, 4, 4), row by row, lengths in mm


def of_poses(position: ArrayLike, quaternion: ArrayLike) -> Matrices:
    """From positions (n, 3) [m] and unit quaternions (n, 4), scalar first."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(np.asarray(quaternion, dtype=np.float64), scalar_first=True)
    return _assembled(turn.as_matrix(), MM * np.asarray(position, dtype=np.float64))


def at_points(points: ArrayLike) -> Matrices:
    """From positions (n, 3) [m] of something that does not turn."""
    points = np.asarray(points, dtype=np.float64)
    return _assembled(np.broadcast_to(np.eye(3), (len(points), 3, 3)), MM * points)


def of_arrows(tails: ArrayLike, arrows: ArrayLike) -> Matrices:
    """From tails (n, 3) [m] and arrows (n, 3) [mm]: they carry the unit arrow along z to there, its width with it."""
    arrows = np.asarray(arrows, dtype=np.float64)
    length = np.linalg.norm(arrows, axis=1)
    z = arrows / length[:, None]
    least = np.eye(3)[np.argmin(np.abs(z), axis=1)]  # the axis that is least along the arrow
    x = np.cross(least, z)
    x /= np.linalg.norm(x, axis=1)[:, None]
    turn = np.stack([x, np.cross(z, x), z], axis=2)
    return _assembled(turn * length[:, None, None], MM * np.asarray(tails, dtype=np.float64))


def applied(matrices: Matrices, points: ArrayLike) -> NDArray[np.float64]:
    """Points (k, 3) [m] fixed in a body, in the femur's frame at every frame: (n, k, 3) [mm]."""
    moved = np.einsum("nij,kj->nki", matrices[:, :3, :3].astype(np.float64), MM * np.asarray(points, dtype=np.float64))
    return moved + matrices[:, None, :3, 3]


def _assembled(turn: NDArray[np.float64], place: NDArray[np.float64]) -> Matrices:
    out = np.zeros((len(place), 4, 4), dtype=np.float32)
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = turn, place, 1.0
    return out
