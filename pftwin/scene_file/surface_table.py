"""The contact's surface: fitted to a mesh, given by its coefficients, or the virtual rig's own implant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from pftwin.errors import InputError
from pftwin.leaves import number, vector
from pftwin.scene_file.host_pose import HostPose
from pftwin.scene_file.region_table import RegionSection
from pftwin.scene_file.section import (
    FileName,
    LengthUnit,
    Pair,
    Point,
    Polynomial,
    Positive,
    PositivePair,
    Section,
    UnitQuaternion,
    problem,
)
from pftwin.scene_file.segments import PoseSection
from pftwin.scene_file.setting import Setting

if TYPE_CHECKING:
    from pftwin.surfaces.closest import Surface

At = tuple[str | int, ...]


class MeshSurfaceSection(Section):
    """A polynomial patch fitted to the trochlear part of a mesh."""

    mesh: FileName = Field(description="STL, OBJ or PLY file of the femoral component")
    units: LengthUnit = Field(description="unit of the mesh's coordinates")
    degree: Polynomial = Field(default="P5", description='polynomial: "P2", "P4", "P5" or another total degree')
    chart: Literal["plane", "cylinder"] = Field(default="plane", description="heights over a plane or about an axis")
    weights: Literal["vertex", "area"] = Field(default="vertex", description="every vertex alike, or by area")
    repair: bool = Field(default=False, description="turn triangles that face the wrong way")
    flip: bool = Field(default=False, description="turn all triangles: for a mesh whose normals point into the bone")
    mesh_pose: PoseSection = Field(default_factory=PoseSection, description="the mesh's frame in the femur's")
    region: RegionSection = Field(default_factory=RegionSection, description="which part of the mesh is trochlea")

    def build(self, setting: Setting, at: At) -> Surface:
        """The patch; a note says how well it fits."""
        from pftwin.surfaces.fit import fit_patch
        from pftwin.surfaces.mesh import SurfaceMesh, load_mesh

        document = setting.document
        with document.naming(*at, "mesh"):
            mesh = load_mesh(setting.path(self.mesh), units=self.units, repair=self.repair)
        frame = self.mesh_pose.pose()
        mesh = mesh.flipped() if self.flip else mesh
        mesh = setting.side.mesh("femur", SurfaceMesh(frame.apply(mesh.vertices), mesh.faces, mesh.source))
        with document.naming(*at, "region"):
            region = self.region.find(mesh, frame, setting)
        with document.naming(*at, "degree"):
            fit = fit_patch(
                mesh, degree=setting.contact or self.degree, chart=self.chart, region=region, weights=self.weights
            )
        setting.notes.append(f"{mesh.source}: {fit}")
        return fit.patch


class ChartSection(Section):
    """Where a patch's coordinates are."""

    type: Literal["plane", "cylinder"] = Field(description="heights over a plane, or about the frame's y axis")
    origin_m: Point = Field(default=[0.0, 0.0, 0.0], description="origin of the chart's frame, femur frame [m]")
    quaternion_wxyz: UnitQuaternion = Field(
        default=[1.0, 0.0, 0.0, 0.0], description="orientation of the chart's frame in the femur's (w, x, y, z)"
    )
    radius_m: Positive | None = Field(default=None, description="radius that makes the cylinder's angle a length [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.type == "cylinder") != (self.radius_m is not None):
            raise problem(f"a {self.type} chart {'without' if self.type == 'cylinder' else 'with'} radius_m")
        return self


class PatchSurfaceSection(Section):
    """A polynomial patch by its coefficients: height = sum of c_ij a^i b^j, a = (u - u0) / half_u, b likewise."""

    coefficients_m: list[float] = Field(
        description="coefficients c_ij [m]: all i for j = 0, then all i for j = 1, ..., i + j up to the degree"
    )
    degree: Polynomial = Field(default="P5", description='polynomial: "P2", "P4", "P5" or another total degree')
    chart: ChartSection = Field(description="table: the chart")
    center_m: Pair = Field(default=[0.0, 0.0], description="centre (u0, v0) of the patch's rectangle [m]")
    half_size_m: PositivePair = Field(description="half size (half_u, half_v) of the patch's rectangle [m]")

    def build(self, setting: Setting, at: At) -> Surface:
        """The patch."""
        from pftwin.spatial import Rotation
        from pftwin.surfaces.charts import CylindricalChart, PlaneChart
        from pftwin.surfaces.fit import parse_degree
        from pftwin.surfaces.patch import PolynomialPatch, exponents

        document = setting.document
        with document.naming(*at, "degree"):
            degree = parse_degree(self.degree)
            refuse_other_degree(setting, degree)
        powers = exponents(degree)
        if len(self.coefficients_m) != len(powers):
            place, _, _ = document.locate((*at, "coefficients_m"))
            raise InputError(
                f"{len(self.coefficients_m)} coefficients",
                where=document.describe(place),
                expected=f"the {len(powers)} coefficients of P{degree}",
            )
        # A mirrored chart keeps a right-handed frame by turning its own y round, so odd powers of v change sign.
        odd = -1.0 if setting.side.left else 1.0
        frame = HostPose.of(self.chart.origin_m, self.chart.quaternion_wxyz)
        origin = setting.side.points("femur", frame.position)
        axes = setting.side.matrices["femur"] @ frame.matrix * np.array([1.0, odd, 1.0])
        where = vector(origin), Rotation.from_array(number(axes))
        chart = (
            PlaneChart(*where) if self.chart.radius_m is None else CylindricalChart(*where, number(self.chart.radius_m))
        )
        coefficients = [c * odd**j for c, (_, j) in zip(self.coefficients_m, powers, strict=True)]
        center = number(self.center_m[0]), number(odd * self.center_m[1])
        half = number(self.half_size_m[0]), number(self.half_size_m[1])
        return PolynomialPatch(chart, number(coefficients), center, half, degree)


class ImplantSurfaceSection(Section):
    """A smooth parametric implant."""

    implant: Literal["rig"] = Field(description='"rig": the femoral component of the virtual rig')

    def build(self, setting: Setting, at: At) -> Surface:
        """The virtual rig's femoral component, exact."""
        from pftwin.surfaces.implant import rig_implant

        with setting.document.naming(*at):
            refuse_other_degree(setting, None)
            if not np.array_equal(setting.side.matrices["femur"], np.eye(3)):
                raise InputError("the rig's implant is a right one in anatomical axes", expected="no [axes] femur")
        return rig_implant()


def refuse_other_degree(setting: Setting, degree: int | None) -> None:
    """A polynomial asked for on the command line can only be had where there is a mesh to fit it to."""
    from pftwin.surfaces.fit import parse_degree

    if setting.contact is not None and parse_degree(setting.contact) != degree:
        raise InputError(
            f"{setting.contact} was asked for, and this surface is not fitted to a mesh",
            remedy="leave it as it is, or give the surface as a mesh",
        )


def _which(value: Any) -> str:
    keys = value if isinstance(value, dict) else {}
    if "implant" in keys:
        return "<implant>"
    return "<patch>" if any(k.startswith("coefficients") for k in keys) else "<mesh>"


SurfaceSection = Annotated[
    Annotated[MeshSurfaceSection, Tag("<mesh>")]
    | Annotated[PatchSurfaceSection, Tag("<patch>")]
    | Annotated[ImplantSurfaceSection, Tag("<implant>")],
    Discriminator(_which),
]
