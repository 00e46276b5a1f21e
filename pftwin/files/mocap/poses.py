"""Time series of a body's poses.

Left knees are mirrored on input, so that internally every knee is a right one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array
from pftwin.base.rotations import continuous_signs
from pftwin.base.spatial import Pose
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.tables import Sampled, increasing_times

_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class PoseSeries(Sampled):
    """Poses of a frame B in its parent A over time: X_AB(t_i).

    Args:
        times: (n,) seconds, strictly increasing.
        positions: (n, 3) metres, B's origin in A.
        quaternions: (n, 4), scalar first, rotating B's coordinates to A's. Norms that differ from 1 by up to 1e-3 are
            normalised; signs are chosen such that successive quaternions are continuous.
        residual_rms: (n,) metres: rms distance of each frame's markers from the fitted rigid body; None: unknown.
        source: origin of the data, for messages.

    Raises:
        InputError: repeated or unsorted times, wrong shapes, missing values, a quaternion that is not a unit
            quaternion; the message names the row (from 1).
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    residual_rms: NDArray[np.float64] | None = None
    source: str = "poses"

    def __post_init__(self) -> None:
        times = increasing_times(self.times, where=self.source)
        positions = self._array("positions", (times.size, 3))
        quaternions = self._array("quaternions", (times.size, 4))
        for label, array in (("positions", positions), ("quaternions", quaternions)):
            if (bad := np.flatnonzero(~np.isfinite(array).all(axis=1))).size:
                raise InputError(f"row {bad[0] + 1} of the {label} is missing or not finite", where=self.source)
        norms = np.linalg.norm(quaternions, axis=1)
        if (bad := np.flatnonzero(np.abs(norms - 1) > _UNIT_TOLERANCE)).size:
            raise InputError(
                f"row {bad[0] + 1}: a quaternion of length {norms[bad[0]]:.6g}",
                where=self.source,
                expected=f"unit quaternions (w, x, y, z), to within {_UNIT_TOLERANCE:g}",
                remedy="check the order of the columns and the unit of the file",
            )
        quaternions = continuous_signs(quaternions / norms[:, None])
        residual = None if self.residual_rms is None else self._array("residual_rms", (times.size,))
        self._set(times=times, positions=positions, quaternions=quaternions, residual_rms=residual)

    @staticmethod
    def from_matrices(
        times: ArrayLike,
        positions: ArrayLike,
        matrices: ArrayLike,
        *,
        residual_rms: NDArray[np.float64] | None = None,
        source: str = "poses",
    ) -> PoseSeries:
        """Makes a series from positions (n, 3) [m] and rotation matrices (n, 3, 3), whose columns are B's axes in A."""
        from scipy.spatial.transform import Rotation

        quaternions = Rotation.from_matrix(np.asarray(matrices)).as_quat(scalar_first=True)
        return PoseSeries(np.asarray(times), np.asarray(positions), quaternions, residual_rms, source)

    def matrices(self) -> NDArray[np.float64]:
        """Rotation matrices (n, 3, 3); columns are B's axes in A."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternions, scalar_first=True).as_matrix()

    def compose(self, fixed: Pose) -> PoseSeries:
        """X_AC = X_AB X_BC for a frame C fixed in B, for instance an anatomical frame in that of a cluster."""
        one = _fixed(fixed, np.zeros(1))
        turned = np.einsum("nij,j->ni", self.matrices(), one.positions[0])
        quaternions = quaternion_product(self.quaternions, one.quaternions)
        return replace(self, positions=self.positions + turned, quaternions=quaternions)

    def relative_to(self, other: PoseSeries) -> PoseSeries:
        """X_CB = X_AC^-1 X_AB for another body C recorded in the same parent A at the same times."""
        check_same_times(self, other)
        positions = np.einsum("nji,nj->ni", other.matrices(), self.positions - other.positions)
        quaternions = quaternion_product(other.quaternions * np.array([1.0, -1, -1, -1]), self.quaternions)
        return replace(
            self, positions=positions, quaternions=quaternions, source=f"{self.source} relative to {other.source}"
        )

    def seen_from(self, fixed: Pose) -> PoseSeries:
        """X_CB = X_AC^-1 X_AB for a frame C fixed in A."""
        return self.relative_to(_fixed(fixed, self.times))


def _fixed(pose: Pose, times: NDArray[np.float64]) -> PoseSeries:
    """A fixed pose repeated at several times."""
    position, quaternion = host_array(pose.position), host_array(pose.orientation)
    if position.shape != (3,) or quaternion.shape != (4,):
        raise InputError(f"a batch of poses of shape {position.shape[:-1]}", where="pose", expected="one fixed pose")
    positions, quaternions = (np.tile(part, (times.size, 1)) for part in (position, quaternion))
    return PoseSeries(times, positions, quaternions, source="a fixed frame")


def quaternion_product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Hamilton product of quaternions (..., 4), scalar first: the rotation b followed by a."""
    aw, av = a[..., :1], a[..., 1:]
    bw, bv = b[..., :1], b[..., 1:]
    scalar = aw * bw - np.sum(av * bv, axis=-1, keepdims=True)
    return np.concatenate([scalar, aw * bv + bw * av + np.cross(av, bv)], axis=-1)


def check_same_times(a: PoseSeries, b: PoseSeries) -> None:
    """Checks that two recordings have the same times.

    Raises:
        InputError: different numbers of frames, or times.
    """
    if a.times.size != b.times.size:
        found = f"{a.times.size} frames in {a.source}, {b.times.size} in {b.source}"
    else:
        off = np.flatnonzero(np.abs(a.times - b.times) > 1e-6 * max(1.0, float(np.ptp(a.times))))
        if not off.size:
            return
        i = int(off[0])
        found = f"row {i + 1} is at {a.times[i]:.9g} s in {a.source} and at {b.times[i]:.9g} s in {b.source}"
    raise InputError(found, where="times", expected="both bodies recorded at the same times")


def mirror_left_markers(markers: MarkerTrajectories, *, medial_lateral: str) -> MarkerTrajectories:
    """Mirrors markers about the sagittal plane: the coordinate along the medial-lateral axis changes its sign.

    Args:
        markers: of a left knee.
        medial_lateral: the laboratory's medial-lateral axis, "x", "y" or "z".
    """
    return replace(
        markers, positions=markers.positions * _reflection(medial_lateral), source=f"{markers.source} (mirrored)"
    )


def mirror_left_poses(poses: PoseSeries, *, medial_lateral: str, body_medial_lateral: str) -> PoseSeries:
    """Mirrors poses about the sagittal plane.

    p' = S p, R' = S R S_b with the reflections S in the parent's and S_b in the body's axes. The body's geometry must
    be mirrored along `body_medial_lateral` too.

    Args:
        poses: of a body of a left knee.
        medial_lateral: the parent frame's medial-lateral axis, "x", "y" or "z".
        body_medial_lateral: the body frame's medial-lateral axis.
    """
    parent, body = _reflection(medial_lateral), _reflection(body_medial_lateral)
    return PoseSeries.from_matrices(
        poses.times,
        poses.positions * parent,
        parent[:, None] * poses.matrices() * body,
        residual_rms=poses.residual_rms,
        source=f"{poses.source} (mirrored)",
    )


def _reflection(axis: str) -> NDArray[np.float64]:
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}", where="medial_lateral", expected="'x', 'y' or 'z'")
    signs = np.ones(3)
    signs["xyz".index(axis)] = -1.0
    return signs
