"""Tables of meshes on bones: the femur's with its facets and the button's, for contact; and [bones], for drawings.

Also checks the start for poses from which no equilibrium can be found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.scene_file.effect_tables import Setting
from pftwin.files.scene_file.section import Point, Positive, Section, problem
from pftwin.files.scene_file.side import HostPose
from pftwin.files.scene_file.surface_table import MeshFileSection, RegionSection

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.region import TrochlearRegion
    from pftwin.model.drawn_bones import DrawnBones


class FemurMesh(NamedTuple):
    """The femur's mesh in the femur's frame."""

    mesh: SurfaceMesh
    lateral: NDArray[np.bool_] | None  # (m,) which triangles are on the lateral facet; None: a single facet
    region: TrochlearRegion | None


class FemurMeshSection(MeshFileSection):
    """The femur's surface, fixed in the femur."""

    facets: Literal["medial_lateral", "one"] = Field(
        default="medial_lateral",
        description='"medial_lateral": divided by the groove line; "one": a surface without a groove',
    )
    region: RegionSection = Field(
        default_factory=RegionSection, description="table: region of the trochlea, whose groove line divides the facets"
    )

    def _check(self) -> None:
        if self.facets == "one" and "region" in self.model_fields_set:
            raise problem('a region with facets = "one"', expected="one of them")

    def build(self, setting: Setting) -> FemurMesh:
        """The mesh with its facets."""
        mesh = setting.side.mesh("femur", self.read(setting))
        if self.facets == "one":
            return FemurMesh(mesh, None, None)
        from pftwin.geometry.contact.patch_mesh import lateral_of_groove

        with setting.naming("region"):
            region = self.region.find(mesh, self.mesh_pose.pose(), setting)
        return FemurMesh(mesh, lateral_of_groove(mesh, region), region)


class PlacedButton(NamedTuple):
    """The button's mesh in the patella's axes."""

    mesh: SurfaceMesh  # relative to the origin
    origin: Floats  # (3,) point that results track, patella's frame [m]


class MeshButtonSection(MeshFileSection):
    """The button as a mesh; methods for spheres use the sphere that is fitted to it."""

    center_m: Point | None = Field(
        default=None, description="point that results track, patella frame [m]; by default the mesh frame's origin"
    )
    tolerance_m: Positive | None = Field(
        default=None, description="for the fitted sphere: largest deviation of the spherical part [m]"
    )

    def triangles(self, setting: Setting) -> PlacedButton:
        """The mesh."""
        _refuse_given(self, "tolerance_m", "there is no sphere to fit: the triangles themselves touch", setting)
        from pftwin.geometry.mesh.mesh import SurfaceMesh

        mesh = setting.side.mesh("patella", self.read(setting))
        center = self.mesh_pose.position_m if self.center_m is None else self.center_m
        origin = setting.points("patella", center)
        return PlacedButton(SurfaceMesh(mesh.vertices - origin, mesh.faces, mesh.source), origin)

    def sphere(self, setting: Setting, label: str) -> tuple[Floats, float]:
        """See `Setting.sphere`."""
        _refuse_given(self, "center_m", "the fitted sphere has its own centre", setting)
        return setting.sphere(self.read(setting), label, self.tolerance_m)


class SphereButtonSection(Section):
    """The button as a sphere; methods for triangles use an icosphere."""

    radius_m: Positive = Field(description="radius of the sphere [m]")
    center_m: Point = Field(default=[0.0, 0.0, 0.0], description="its centre, patella frame [m]")
    deviation_m: Positive | None = Field(
        default=None, description="largest deviation of triangles from the sphere [m]; 0.006 mm by default"
    )

    def triangles(self, setting: Setting) -> PlacedButton:
        """The coarsest icosphere within the deviation."""
        from pftwin.geometry.mesh.icosphere import RESOLUTIONS, button_mesh

        with setting.naming("deviation_m"):
            mesh = button_mesh(self.radius_m, self.deviation_m or RESOLUTIONS["FM"])
        return PlacedButton(mesh, setting.points("patella", self.center_m))

    def sphere(self, setting: Setting, label: str) -> tuple[Floats, float]:
        """Centre (3,) in the patella's frame and radius of the exact sphere [m]."""
        _refuse_given(self, "deviation_m", "the sphere is exact: it has no triangles", setting)
        return setting.points("patella", self.center_m), self.radius_m


def _refuse_given(section: Section, field: str, why: str, setting: Setting) -> None:
    if getattr(section, field) is not None:
        raise InputError(why, where=setting.where(field), remedy="leave it out")


def _which(value: Any) -> str:
    keys = value if isinstance(value, dict) else {}
    return "<sphere>" if "mesh" not in keys and any(k.startswith("radius") for k in keys) else "<mesh>"


ButtonSection = Annotated[
    Annotated[MeshButtonSection, Tag("<mesh>")] | Annotated[SphereButtonSection, Tag("<sphere>")],
    Discriminator(_which),
]


def refuse_patch(setting: Setting) -> None:
    """Raises InputError if the command line requests a patch, which cannot replace meshes."""
    if setting.contact is not None:
        raise InputError(
            f"{setting.contact} was requested, but this contact is of meshes",
            where=setting.where(),
            remedy="leave --contact out, or a scene file with a [contact] table",
        )


def check_start(femur: FemurMesh, button: PlacedButton, setting: Setting) -> None:
    """Checks the start for poses from which no equilibrium can be found; adds a note if it may be difficult.

    Raises InputError for most of the button behind the femur's surface, or all of it far away.
    """
    from pftwin.geometry.contact.behind import mutual_place
    from pftwin.geometry.contact.depths import DEEPEST
    from pftwin.geometry.mesh.mesh import PLAUSIBLE

    start = setting.start @ HostPose(button.origin, np.eye(3))
    found = mutual_place(femur.mesh, button.mesh, start.position, start.matrix)
    where = setting.where()
    poses = "[patella] start, center_m and mesh_pose of both meshes, and [axes]"
    if found.behind > 0.5:
        raise InputError(
            f"at the first frame {found.behind:.0%} of the button are inside the femur",
            where=where,
            expected="a start at which they hardly touch",
            remedy=f"check {poses}; flip = true if normals point inward (pftwin doctor-mesh)",
        )
    if found.gap > PLAUSIBLE[1]:
        raise InputError(
            f"at the first frame button and femur are {1e3 * found.gap:.0f} mm apart",
            where=where,
            expected=f"less than {1e3 * PLAUSIBLE[1]:.0f} mm",
            remedy=f"check {poses}",
        )
    if found.deepest > DEEPEST:
        setting.notes.append(
            f"{where}: at the first frame the button is {1e3 * found.deepest:.2g} mm deep in the femur: "
            "deeper than contact is made for, so the search for equilibrium may fail"
        )


SIZES = (0.015, 0.65)  # plausible longest side of a bone or a part of one [m]
FARTHEST = 0.2  # largest plausible distance of a bone's nearest point from its frame's origin [m]


class BoneSection(MeshFileSection):
    """A bone's surface in its body's frame."""

    repair: bool = Field(default=False, description="reorient triangles that face the wrong way")

    def build(self, body: str, setting: Setting) -> SurfaceMesh:
        """The surface in the scene's frame of its body.

        Raises InputError for a mesh that is unreadable, has an implausible size or is far from its frame's origin.
        """
        from pftwin.geometry.mesh.mesh import load_mesh

        with setting.naming("mesh"):
            mesh = load_mesh(setting.path(self.mesh), units=self.units, size=SIZES, repair=self.repair)
        mesh = setting.side.mesh(body, self._placed(mesh))
        if (away := float(np.linalg.norm(mesh.vertices, axis=1).min())) > FARTHEST:
            raise InputError(
                f"all of it is {1e3 * away:.0f} mm or farther from the origin of the {body}'s frame",
                where=setting.where("mesh"),
                expected=f"less than {1e3 * FARTHEST:.0f} mm",
                remedy="mesh_pose, where the mesh has another frame than the bone; check units",
            )
        return mesh


class DrawnBonesSection(Section):
    """Surfaces of bones for drawings of the scene; they exert no force, and contact needs its own meshes."""

    femur: BoneSection | None = Field(default=None, description="table: the femur's surface; schematic by default")
    patella: BoneSection | None = Field(default=None, description="table: the patella's; schematic by default")
    tibia: BoneSection | None = Field(default=None, description="table: the tibia's; schematic by default")

    def _check(self) -> None:
        if not self.model_fields_set:
            raise problem("no bone", expected="femur, patella or tibia, or no such table")

    def build(self, setting: Setting) -> DrawnBones:
        """The surfaces in the table."""
        from pftwin.model.drawn_bones import DrawnBones

        given = ((body, getattr(self, body)) for body in ("femur", "patella", "tibia"))
        return DrawnBones({body: bone.build(body, setting.at(body)) for body, bone in given if bone is not None})
