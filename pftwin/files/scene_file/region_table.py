"""Which part of a mesh is trochlea."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import Field, model_validator

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.host_pose import HostPose
from pftwin.files.scene_file.section import Direction, Pair, Point, Positive, Section, problem
from pftwin.files.scene_file.setting import Setting

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.region import TrochlearRegion


class RegionSection(Section):
    """Which part of the mesh is trochlea: looked for, or about a known axis."""

    anterior: Direction | None = Field(default=None, description="anterior direction, the mesh's frame; by [axes]")
    proximal: Direction | None = Field(default=None, description="proximal direction, the mesh's frame; by [axes]")
    half_width_m: Positive = Field(default=0.02, description="half width of the region, medial-lateral [m]")
    angles_deg: Pair = Field(
        default=[-60.0, 60.0], description="limits about the trochlear axis: 0 anterior, proximal positive [deg]"
    )
    axis_origin_m: Point | None = Field(
        default=None, description="point of the trochlear axis in line with the groove, where the axis is known [m]"
    )
    axis_radius_m: Positive | None = Field(default=None, description="distance of the groove from that axis [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.angles_deg[0] >= self.angles_deg[1]:
            raise problem(f"angles_deg is {self.angles_deg}", expected="the lower limit first")
        if (self.axis_origin_m is None) != (self.axis_radius_m is None):
            raise problem("only one of axis_origin_m and axis_radius_m is given", expected="both or neither")
        return self

    def find(self, mesh: SurfaceMesh, frame: HostPose, setting: Setting) -> TrochlearRegion:
        """The region on a mesh that is in the femur's frame already; `frame` is the mesh's own frame there."""
        from pftwin.base.spatial import Rotation
        from pftwin.geometry.patch.charts import CylindricalChart
        from pftwin.geometry.patch.region import region_about, trochlear_region

        anterior, proximal = (
            usual if given is None else setting.side.points("femur", np.asarray(given) @ frame.matrix.T)
            for given, usual in ((self.anterior, np.array([0.0, 0, 1])), (self.proximal, np.array([1.0, 0, 0])))
        )
        low, high = (math.radians(a) for a in self.angles_deg)
        if self.axis_origin_m is None:
            return trochlear_region(
                mesh, anterior=anterior, proximal=proximal, half_width=self.half_width_m, angles=(low, high)
            )
        front = mesh.vertices @ anterior
        if (mesh.vertex_normals @ anterior)[front >= np.quantile(front, 0.95)].mean() < 0:
            raise InputError(
                "the normals of the foremost vertices point backward",
                where=mesh.source,
                expected="normals out of the bone, and anterior in the mesh's own frame",
                remedy="flip = true if the normals point into the bone; else check anterior",
            )
        lateral = np.cross(anterior, proximal)
        size = float(np.linalg.norm(lateral))
        if size < 0.5 * float(np.linalg.norm(anterior) * np.linalg.norm(proximal)):
            raise InputError("anterior and proximal are nearly parallel", expected="about 90 deg between them")
        y, z = lateral / size, anterior / np.linalg.norm(anterior)
        axes = np.stack([np.cross(y, z), y, z], axis=1)
        origin = setting.side.points("femur", frame.apply(self.axis_origin_m))
        chart = CylindricalChart(vector(origin), Rotation.from_array(number(axes)), number(self.axis_radius_m or 0.0))
        return region_about(mesh, chart, angles=(low, high), half_width=self.half_width_m)
