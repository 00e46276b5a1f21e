"""Tables of the contact's surface: fitted to a mesh's trochlea, given by coefficients, or the rig's implant."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Rotation
from pftwin.files.scene_file.coefficient_tables import PatchSurfaceSection, SplineSurfaceSection, refuse_other
from pftwin.files.scene_file.effect_tables import Setting
from pftwin.files.scene_file.section import (
    Direction,
    FileName,
    LengthUnit,
    Pair,
    Point,
    Polynomial,
    Positive,
    Section,
    problem,
)
from pftwin.files.scene_file.segments import PoseSection
from pftwin.files.scene_file.side import HostPose
from pftwin.geometry.patch.charts import CylindricalChart

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.closest import Surface
    from pftwin.geometry.patch.emphasis import WeightedPart
    from pftwin.geometry.patch.region import TrochlearRegion


class RegionSection(Section):
    """The trochlear region of the mesh: found by a search, or about a known axis."""

    anterior: Direction | None = Field(default=None, description="anterior direction, mesh's frame; default: [axes]")
    proximal: Direction | None = Field(default=None, description="proximal direction, mesh's frame; default: [axes]")
    half_width_m: Positive = Field(default=0.02, description="half width of the region, medial-lateral [m]")
    angles_deg: Pair = Field(
        default=[-60.0, 60.0], description="limits about the trochlear axis: 0 anterior, proximal positive [deg]"
    )
    axis_origin_m: Point | None = Field(
        default=None, description="point of the trochlear axis at the groove, if the axis is known [m]"
    )
    axis_radius_m: Positive | None = Field(default=None, description="distance of the groove from that axis [m]")

    def _check(self) -> None:
        if self.angles_deg[0] >= self.angles_deg[1]:
            raise problem(f"angles_deg is {self.angles_deg}", expected="the lower limit first")
        if (self.axis_origin_m is None) != (self.axis_radius_m is None):
            raise problem("only one of axis_origin_m and axis_radius_m is given", expected="both or neither")

    def find(self, mesh: SurfaceMesh, frame: HostPose, setting: Setting) -> TrochlearRegion:
        """The region on a mesh in the femur's frame; `frame` is the pose of the mesh's original frame."""
        from pftwin.geometry.patch.region import check_outward, hinted_axes, region_about, trochlear_region

        anterior, proximal = (
            usual if given is None else setting.side.points("femur", np.asarray(given) @ frame.matrix.T)
            for given, usual in ((self.anterior, np.array([0.0, 0, 1])), (self.proximal, np.array([1.0, 0, 0])))
        )
        low, high = (math.radians(a) for a in self.angles_deg)
        if self.axis_origin_m is None:
            return trochlear_region(
                mesh, anterior=anterior, proximal=proximal, half_width=self.half_width_m, angles=(low, high)
            )
        axes = hinted_axes(anterior, proximal)
        check_outward(mesh.vertices @ axes, mesh.vertex_normals @ axes, mesh.source)
        origin = setting.side.points("femur", frame.apply(self.axis_origin_m))
        chart = CylindricalChart(vector(origin), Rotation.from_array(number(axes)), number(self.axis_radius_m or 0.0))
        return region_about(mesh, chart, angles=(low, high), half_width=self.half_width_m)


class WeightedPartSection(Section):
    """A part of the region with another weight in the fit. Where parts overlap the last one applies."""

    weight: Positive = Field(description="weight of each vertex in the part; elsewhere it is 1")
    angles_deg: Pair | None = Field(default=None, description="limits about the trochlear axis [deg]; none by default")
    across_m: Pair | None = Field(
        default=None, description="limits from the region's middle, positive laterally [m]; none by default"
    )

    def _check(self) -> None:
        for name, limits in (("angles_deg", self.angles_deg), ("across_m", self.across_m)):
            if limits is not None and limits[0] >= limits[1]:
                raise problem(f"{name} is {limits}", expected="the lower limit first")

    def part(self) -> WeightedPart:
        """The part, in radians and metres."""
        from pftwin.geometry.patch.emphasis import WeightedPart

        limits: dict[str, tuple[float, float]] = {}
        if self.angles_deg is not None:
            limits["angles"] = math.radians(self.angles_deg[0]), math.radians(self.angles_deg[1])
        if self.across_m is not None:
            limits["across"] = self.across_m[0], self.across_m[1]
        return WeightedPart(self.weight, **limits)


class MeshFileSection(Section):
    """A mesh in a file, and the pose of its frame."""

    mesh: FileName = Field(description="STL, OBJ or PLY file")
    units: LengthUnit = Field(description="unit of the mesh's coordinates")
    repair: bool = Field(default=False, description="reorient triangles that face the wrong way, remove duplicates")
    flip: bool = Field(default=False, description="reverse all triangles: for a mesh whose normals point inward")
    mesh_pose: PoseSection = Field(default_factory=PoseSection, description="pose of the mesh's frame in its body's")

    def read(self, setting: Setting) -> SurfaceMesh:
        """Reads the mesh, in its body's frame with the file's axes; adds notes on its faults."""
        from pftwin.geometry.mesh.doctor import checked_mesh

        with setting.naming("mesh"):
            found = checked_mesh(setting.path(self.mesh), units=self.units, repair=self.repair)
        setting.notes.extend(found.notes)
        return self._placed(found.mesh)

    def _placed(self, mesh: SurfaceMesh) -> SurfaceMesh:
        mesh = mesh.flipped() if self.flip else mesh
        return replace(mesh, vertices=self.mesh_pose.pose().apply(mesh.vertices))


class MeshSurfaceSection(MeshFileSection):
    """A patch, polynomial or spline, fitted to the trochlear part of a mesh."""

    repair: bool = Field(default=False, description="reorient triangles that face the wrong way")
    degree: Polynomial = Field(default="P5", description='polynomial: "P2", "P4", "P5" or another total degree')
    kind: Literal["polynomial", "spline"] = Field(
        default="polynomial", description='"polynomial" of that degree, or "spline": bicubic, C2'
    )
    tolerance_m: Positive | None = Field(
        default=None, description="for a spline: rms of the heights' residuals to reach with short enough cells [m]"
    )
    chart: Literal["plane", "cylinder"] | None = Field(
        default=None,
        description="heights over a plane or about an axis; by default the plane, or for a spline that misses its "
        "tolerance or folds over there, the better of both",
    )
    weights: Literal["vertex", "area"] = Field(default="vertex", description="equal weights of vertices, or by area")
    region: RegionSection = Field(default_factory=RegionSection, description="the trochlear region of the mesh")
    emphasis: list[WeightedPartSection] = Field(
        default=[], description="parts of the region with other weights, such as where the patella dislocates"
    )

    def _check(self) -> None:
        if self.kind == "spline" and "degree" in self.model_fields_set:
            raise problem("a spline with a degree", expected='kind = "spline" without it, or kind = "polynomial"')
        if self.kind == "polynomial" and self.tolerance_m is not None:
            raise problem("a polynomial with tolerance_m", expected='degree = "P5" or higher, or kind = "spline"')

    def build(self, setting: Setting) -> Surface:
        """The fitted patch; adds a note on the fit."""
        from pftwin.geometry.mesh.mesh import load_mesh
        from pftwin.geometry.patch.emphasis import emphasis
        from pftwin.geometry.patch.fit import SPLINE, fit_named, parse_name

        with setting.naming("mesh"):
            mesh = load_mesh(setting.path(self.mesh), units=self.units, repair=self.repair)
        mesh = setting.side.mesh("femur", self._placed(mesh))
        with setting.naming("region"):
            region = self.region.find(mesh, self.mesh_pose.pose(), setting)
        with setting.naming("degree"):
            name = parse_name(setting.contact or (SPLINE if self.kind == SPLINE else self.degree))
            asked = {"tolerance": self.tolerance_m} if name == SPLINE and self.tolerance_m is not None else {}
            weighted = emphasis(region, [part.part() for part in self.emphasis])
            fit = fit_named(
                mesh, name, chart=self.chart, region=region, weights=self.weights, emphasis=weighted, **asked
            )
        setting.notes.append(f"{mesh.source}: {fit}")
        return fit.patch


class ImplantSurfaceSection(Section):
    """A smooth parametric implant."""

    implant: Literal["rig"] = Field(description='"rig": the femoral component of the virtual rig')

    def build(self, setting: Setting) -> Surface:
        """The femoral component of the virtual rig."""
        from pftwin.geometry.patch.implant import rig_implant

        with setting.naming():
            refuse_other(setting, None)
            if not np.array_equal(setting.side.matrices["femur"], np.eye(3)):
                raise InputError("the rig's implant is a right one in anatomical axes", expected="no [axes] femur")
        return rig_implant()


def _which(value: Any) -> str:
    keys = value if isinstance(value, dict) else {}
    if "implant" in keys:
        return "<implant>"
    if any(k.startswith("spline_coefficients") for k in keys):
        return "<spline>"
    return "<patch>" if any(k.startswith("coefficients") for k in keys) else "<mesh>"


SurfaceSection = Annotated[
    Annotated[MeshSurfaceSection, Tag("<mesh>")]
    | Annotated[PatchSurfaceSection, Tag("<patch>")]
    | Annotated[SplineSurfaceSection, Tag("<spline>")]
    | Annotated[ImplantSurfaceSection, Tag("<implant>")],
    Discriminator(_which),
]
