"""Transforms data from a file's axes to the anatomical axes of a right knee; left knees are mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Discriminator, Field, Tag

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion
from pftwin.base.written_amounts import axis_named
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.section import Section, problem

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh


@dataclass(frozen=True, eq=False)
class HostPose:
    """Pose X_AB as NumPy arrays: p_A = position + matrix p_B."""

    position: Array  # (3,) [m]
    matrix: Array  # (3, 3)

    @staticmethod
    def of(position: ArrayLike, quaternion: ArrayLike) -> HostPose:
        """Makes a pose from a position [m] and a unit quaternion (w, x, y, z)."""
        from scipy.spatial.transform import Rotation

        matrix = Rotation.from_quat(np.asarray(quaternion, dtype=np.float64), scalar_first=True).as_matrix()
        return HostPose(np.asarray(position, dtype=np.float64), matrix)

    def apply(self, points: ArrayLike) -> Array:
        """Transforms points (..., 3) [m] from B to A."""
        return self.position + np.asarray(points, dtype=np.float64) @ self.matrix.T

    def __matmul__(self, other: HostPose) -> HostPose:
        return HostPose(self.apply(other.position), self.matrix @ other.matrix)

    def inverse(self) -> HostPose:
        """The inverse pose X_BA."""
        return HostPose(-self.position @ self.matrix, self.matrix.T)

    def quaternion(self) -> Array:
        """Orientation as a quaternion (w, x, y, z)."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(self.matrix).as_quat(scalar_first=True, canonical=True)

    def pose(self) -> Pose:
        """The pose as a JAX pytree, in JAX's default float type."""
        return Pose(vector(self.position), Quaternion(*(number(c) for c in self.quaternion())))


Array = NDArray[np.float64]
_BODIES = ("femur", "tibia", "patella")
_RIGHT, _LEFT = ["+x", "+y", "+z"], ["+x", "-y", "+z"]
ISB = "isb"  # x anterior, y proximal, z to the right: Wu et al. (2002) J Biomech 35:543
_ISB_RIGHT, _ISB_LEFT = ["+y", "+z", "+x"], ["+y", "-z", "+x"]


def _three_axes(value: list[str]) -> list[str]:
    if (
        len(value) != 3
        or sorted(a[-1:] for a in value) != ["x", "y", "z"]
        or any(a[:-1] not in ("", "+", "-") for a in value)
    ):
        raise problem(f"found {value}", expected='three axes with signs, as in ["+y", "+z", "+x"]')
    return value


def _which(value: Any) -> str:
    return "<name>" if isinstance(value, str) else "<list>"


Axes = Annotated[
    Annotated[list[str], AfterValidator(_three_axes), Tag("<list>")] | Annotated[Literal["isb"], Tag("<name>")],
    Discriminator(_which),
]


class AxesSection(Section):
    """The axes of each frame that point proximally, laterally and anteriorly; or "isb" for the ISB's axes: x anterior,
    y proximal, z to the right."""

    femur: Axes | None = Field(default=None, description="proximal, lateral, anterior in the femur's frame")
    tibia: Axes | None = Field(default=None, description="proximal, lateral, anterior in the tibia's frame")
    patella: Axes | None = Field(default=None, description="proximal, lateral, anterior in the patella's frame")
    world_medial_lateral: Literal["x", "y", "z"] = Field(
        default="y", description="medial-lateral axis of the world, along which a left knee is mirrored"
    )


@dataclass(frozen=True, eq=False)
class Side:
    """Transformation from each frame's axes to (proximal, lateral, anterior), and from a left to a right knee."""

    matrices: dict[str, Array]  # (3, 3) by frame: rows are the anatomical axes; determinant -1 for a left knee
    left: bool

    @classmethod
    def read(cls, left: bool, axes: AxesSection, document: Document) -> Self:
        """Reads the side and axes of a scene file. Raises InputError for axes of the other side."""
        world = np.eye(3)
        if left:
            world["xyz".index(axes.world_medial_lateral)] *= -1
        matrices = {"world": world, "ground": world}
        for body in _BODIES:
            rows = getattr(axes, body) or (_LEFT if left else _RIGHT)
            if rows == ISB:
                rows = _ISB_LEFT if left else _ISB_RIGHT
            matrices[body] = np.array([axis_named(axis) for axis in rows])
            if (np.linalg.det(matrices[body]) < 0) != left:
                raise InputError(
                    f"{rows} are the axes of a {'right' if left else 'left'} knee",
                    where=document.where("axes", body),
                    expected=f"proximal, lateral, anterior of a {'left' if left else 'right'} one",
                    remedy='check the signs, or side = "left" / "right"',
                )
        return cls(matrices, left)

    def points(self, frame: str, values: ArrayLike) -> Array:
        """Transforms points or directions (..., 3) of a frame ("world", "femur", "tibia" or "patella")."""
        return np.asarray(values, dtype=np.float64) @ self.matrices[frame].T

    def moments(self, values: ArrayLike) -> Array:
        """Reorders principal moments (3,) about the patella's axes."""
        return np.abs(self.matrices["patella"]) @ np.asarray(values, dtype=np.float64)

    def pose(self, parent: str, body: str, pose: HostPose) -> HostPose:
        """Transforms a fixed pose of a body in its parent."""
        a, b = self.matrices[parent], self.matrices[body]
        return HostPose(a @ pose.position, a @ pose.matrix @ b.T)

    def poses(self, parent: str, body: str, poses: PoseSeries) -> PoseSeries:
        """Transforms recorded poses of a body in its parent."""
        a, b = self.matrices[parent], self.matrices[body]
        return PoseSeries.from_matrices(
            poses.times,
            poses.positions @ a.T,
            a @ poses.matrices() @ b.T,
            residual_rms=poses.residual_rms,
            source=poses.source,
        )

    def mesh(self, frame: str, mesh: SurfaceMesh) -> SurfaceMesh:
        """Transforms a surface; for a left knee triangles are reversed, so that normals still point outward."""
        from pftwin.geometry.mesh.mesh import SurfaceMesh

        faces = mesh.faces[:, ::-1].copy() if self.left else mesh.faces
        return SurfaceMesh(self.points(frame, mesh.vertices), faces, mesh.source)
