"""Left knees: every point, pose and mesh of a left knee is mirrored on input; inside, every knee is a right one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from pftwin.mocap.mirror import mirror_left_poses
from pftwin.mocap.poses import PoseSeries
from pftwin.scene_file.host_pose import HostPose
from pftwin.scene_file.section import Section

if TYPE_CHECKING:
    from pftwin.surfaces.mesh import SurfaceMesh

Axis = Literal["x", "y", "z"]


class MedialLateralSection(Section):
    """Which axis is medial-lateral in each frame: needed for a left knee only."""

    world: Axis = Field("y", description="medial-lateral axis of the world (the laboratory)")
    femur: Axis = Field("y", description="medial-lateral axis of the femur's frame")
    tibia: Axis = Field("y", description="medial-lateral axis of the tibia's frame")
    patella: Axis = Field("y", description="medial-lateral axis of the patella's frame")


@dataclass(frozen=True)
class Side:
    """Mirrors a left knee's data along the medial-lateral axis of their frame; leaves a right knee's alone."""

    left: bool
    axes: MedialLateralSection

    def _signs(self, frame: str) -> NDArray[np.float64]:
        signs = np.ones(3)
        if self.left:
            signs["xyz".index(getattr(self.axes, "world" if frame == "ground" else frame))] = -1.0
        return signs

    def points(self, frame: str, values: ArrayLike) -> NDArray[np.float64]:
        """Points or directions (..., 3) of a frame ("world", "femur", "tibia" or "patella")."""
        return np.asarray(values, dtype=np.float64) * self._signs(frame)

    def pose(self, parent: str, body: str, pose: HostPose) -> HostPose:
        """A fixed pose of a body in its parent."""
        a, b = self._signs(parent), self._signs(body)
        return HostPose(pose.position * a, a[:, None] * pose.matrix * b)

    def poses(self, parent: str, body: str, poses: PoseSeries) -> PoseSeries:
        """Recorded poses of a body in its parent."""
        if not self.left:
            return poses
        names = {"world": self.axes.world, "femur": self.axes.femur, "tibia": self.axes.tibia}
        names["patella"] = self.axes.patella
        return mirror_left_poses(poses, medial_lateral=names[parent], body_medial_lateral=names[body])

    def mesh(self, frame: str, mesh: SurfaceMesh) -> SurfaceMesh:
        """A surface; its triangles keep their outer side outside."""
        if not self.left:
            return mesh
        from pftwin.surfaces.mesh import SurfaceMesh

        return SurfaceMesh(mesh.vertices * self._signs(frame), mesh.faces[:, ::-1].copy(), mesh.source)
