"""Poses on the host in double precision, for putting a scene together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HostPose:
    """X_AB: p_A = position + matrix p_B."""

    position: Array  # (3,) [m]
    matrix: Array  # (3, 3)

    @staticmethod
    def identity() -> HostPose:
        """The parent's own frame."""
        return HostPose(np.zeros(3), np.eye(3))

    @staticmethod
    def of(position: ArrayLike, quaternion: ArrayLike) -> HostPose:
        """From a position [m] and a unit quaternion (w, x, y, z)."""
        from scipy.spatial.transform import Rotation

        matrix = Rotation.from_quat(np.asarray(quaternion, dtype=np.float64), scalar_first=True).as_matrix()
        return HostPose(np.asarray(position, dtype=np.float64), matrix)

    def apply(self, points: ArrayLike) -> Array:
        """Points (..., 3) of B in A."""
        return self.position + np.asarray(points, dtype=np.float64) @ self.matrix.T

    def __matmul__(self, other: HostPose) -> HostPose:
        return HostPose(self.apply(other.position), self.matrix @ other.matrix)

    def inverse(self) -> HostPose:
        """X_BA."""
        return HostPose(-self.position @ self.matrix, self.matrix.T)

    def pose(self) -> Pose:
        """For the scene, in JAX's default float type."""
        from scipy.spatial.transform import Rotation

        quaternion = Rotation.from_matrix(self.matrix).as_quat(scalar_first=True, canonical=True)
        return Pose(vector(self.position), Quaternion(*(number(c) for c in quaternion)))
