"""[mesh_contact]: a button on the femur's mesh, by contours and indentation, by volume, or at the nearest points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.contact_table import FloresSection, FrictionSection, HertzSection, HuntCrossleySection
from pftwin.files.scene_file.effect_tables import EffectSection
from pftwin.files.scene_file.mesh_tables import (
    At,
    ButtonMesh,
    ButtonSection,
    ButtonSphere,
    FemurMesh,
    FemurMeshSection,
    check_start,
    refuse_patch,
)
from pftwin.files.scene_file.section import Positive, problem
from pftwin.files.scene_file.setting import Setting
from pftwin.files.scene_file.surface_table import SurfaceSection

if TYPE_CHECKING:
    from pftwin.geometry.contact.patch_mesh import PatchMesh
    from pftwin.geometry.patch.closest import Surface
    from pftwin.model.effects.contact import Contact

_COARSE = 8  # frequency of the icosphere that stands for a sphere where only its place matters


class MeshContactSection(EffectSection):
    """A button fixed in the patella against a mesh fixed in the femur."""

    kind: ClassVar[str] = "mesh_contact"
    method: Literal["contours", "volume", "nearest"] = Field(
        description='where the law\'s indentation is from: "contours" of two meshes that cross, as in the paper; '
        '"volume" of a sphere in a mesh, smooth; "nearest" points of a mesh to a sphere\'s centre'
    )
    femur: FemurMeshSection = Field(description="table: the femur's mesh")
    button: ButtonSection = Field(description="table: the button, mesh or sphere")
    law: Annotated[FloresSection | HuntCrossleySection | HertzSection, Field(discriminator="type")] = Field(
        description='table: the normal force\'s law, type = "flores", "hunt_crossley" or "hertz"'
    )
    effective_radius_m: Positive | None = Field(
        default=None,
        description="of the volume: radius of the sphere that has as large an overlap with a plane [m]; measured on "
        "the mesh by default",
    )
    friction: FrictionSection | None = Field(default=None, description="table: friction, of a sphere; none by default")
    surface: SurfaceSection | None = Field(
        default=None, description="table: a smooth surface by which results tell where the groove is; none by default"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.effective_radius_m is not None and self.method != "volume":
            raise problem(f'effective_radius_m with method = "{self.method}"', expected='method = "volume"')
        if self.friction is not None and self.method == "contours":
            raise problem('friction with method = "contours"', expected='method = "volume" or "nearest": a sphere')
        return self

    def build(self, setting: Setting, at: At) -> Contact:
        """The effect."""
        refuse_patch(setting, at)
        surface = None if self.surface is None else self.surface.build(setting, (*at, "surface"))
        femur = self.femur.build(setting, (*at, "femur"))
        if self.method == "contours":
            button = self.button.triangles(setting, (*at, "button"))
            check_start(femur, button, setting, at)
            with setting.document.naming(*at):
                return self._contours(femur, button, surface)
        sphere = self.button.sphere(setting, (*at, "button"), self.label)
        from pftwin.geometry.mesh.icosphere import icosphere

        check_start(femur, ButtonMesh(icosphere(sphere.radius, _COARSE), sphere.center), setting, at)
        build = self._nearest if self.method == "nearest" else self._volume
        with setting.document.naming(*at):
            contact = build(femur, sphere, surface)
            return contact if self.friction is None else self.friction.added(contact)

    def _contours(self, femur: FemurMesh, button: ButtonMesh, surface: Surface | None) -> Contact:
        from pftwin.geometry.contact.contact_mesh import contact_mesh
        from pftwin.model.effects.mesh_contact import MeshContact

        meshes = contact_mesh(femur.mesh, femur.lateral), contact_mesh(button.mesh)
        return MeshContact(*meshes, self.law.build(), vector(button.origin), surface=surface, name=self.label)

    def _nearest(self, femur: FemurMesh, button: ButtonSphere, surface: Surface | None) -> Contact:
        from pftwin.geometry.contact.mesh_facets import mesh_facets
        from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact

        place = vector(button.center), number(button.radius)
        facets = mesh_facets(femur.mesh, femur.lateral)
        return MeshSphereContact(facets, self.law.build(), *place, surface=surface, name=self.label)

    def _volume(self, femur: FemurMesh, button: ButtonSphere, surface: Surface | None) -> Contact:
        from pftwin.geometry.contact.patch_mesh import patch_mesh
        from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact

        made = patch_mesh(femur.mesh, button.radius, femur.lateral)
        radius = self.effective_radius_m or _measured_radius(femur, made, button.radius)
        place = vector(button.center), number(button.radius), number(radius)
        return MeshVolumeContact(made, self.law.build(), *place, surface=surface, name=self.label)


def _measured_radius(femur: FemurMesh, made: PatchMesh, radius: float) -> float:
    """Beside the groove, where the mesh has one [m]."""
    from pftwin.geometry.contact.overlap import beside_groove, effective_radius

    near = None if femur.region is None else beside_groove(femur.mesh, femur.region, 0.5 * radius)
    return effective_radius(femur.mesh, made, radius, near)
