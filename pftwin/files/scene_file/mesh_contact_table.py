"""[mesh_contact] and [elastic_foundation]: a button on the femur's mesh, with a contact law or elastic layers."""

# ruff: noqa: N815  (units in names are written as units are: MPa)
from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from pftwin.base.arrays import Floats
from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.contact_table import LAW, FrictionSection, Law
from pftwin.files.scene_file.effect_tables import EffectSection, Setting
from pftwin.files.scene_file.mesh_tables import (
    ButtonSection,
    FemurMesh,
    FemurMeshSection,
    PlacedButton,
    check_start,
    refuse_patch,
)
from pftwin.files.scene_file.section import NotNegative, Point, Positive, Section, problem
from pftwin.files.scene_file.surface_table import SurfaceSection

if TYPE_CHECKING:
    from pftwin.geometry.contact.patch_mesh import PatchMesh
    from pftwin.geometry.patch.closest import Surface
    from pftwin.model.effects.base import Effect
    from pftwin.model.effects.contact import Contact
    from pftwin.model.effects.foundation_law import Layer


_COARSE = 8  # frequency of the icosphere that represents a sphere if only its position matters


class _MeshesSection(EffectSection):
    """A button on the femur's mesh."""

    femur: FemurMeshSection = Field(description="table: the femur's mesh")
    button: ButtonSection = Field(description="table: the button, mesh or sphere")
    surface: SurfaceSection | None = Field(
        default=None, description="table: smooth surface that defines the groove in results; none by default"
    )

    def femur_side(self, setting: Setting) -> tuple[FemurMesh, Surface | None]:
        """The femur's mesh, and the smooth surface that defines the groove."""
        refuse_patch(setting)
        surface = None if self.surface is None else self.surface.build(setting.at("surface"))
        femur = self.femur.build(setting.at("femur"))
        return femur, surface


class MeshContactSection(_MeshesSection):
    """Contact between a button fixed in the patella and a mesh fixed in the femur."""

    kind: ClassVar[str] = "mesh_contact"
    method: Literal["contours", "volume", "nearest"] = Field(
        description='source of the indentation: "contours" where two meshes intersect, as in the paper; "volume" of a '
        'sphere in a mesh, smooth; "nearest" points of a mesh to a sphere\'s centre'
    )
    law: Law = LAW
    effective_radius_m: Positive | None = Field(
        default=None,
        description="for the volume: radius of the sphere with the same overlap with a plane [m]; by default measured "
        "on the mesh",
    )
    friction: FrictionSection | None = Field(default=None, description="table: friction, of a sphere; none by default")

    def _check(self) -> None:
        if self.effective_radius_m is not None and self.method != "volume":
            raise problem(f'effective_radius_m with method = "{self.method}"', expected='method = "volume"')
        if self.friction is not None and self.method == "contours":
            raise problem('friction with method = "contours"', expected='method = "volume" or "nearest": a sphere')

    def build(self, setting: Setting) -> Contact:
        """The effect."""
        femur, surface = self.femur_side(setting)
        if self.method == "contours":
            button = self.button.triangles(setting.at("button"))
            check_start(femur, button, setting)
            with setting.naming():
                return self._contours(femur, button, surface)
        center, radius = self.button.sphere(setting.at("button"), self.label)
        from pftwin.geometry.mesh.icosphere import icosphere

        check_start(femur, PlacedButton(icosphere(radius, _COARSE), center), setting)
        build = self._nearest if self.method == "nearest" else self._volume
        with setting.naming():
            contact = build(femur, center, radius, surface)
            return contact if self.friction is None else self.friction.added(contact)

    def _contours(self, femur: FemurMesh, button: PlacedButton, surface: Surface | None) -> Contact:
        from pftwin.geometry.contact.contact_mesh import contact_mesh
        from pftwin.model.effects.mesh_contact import MeshContact

        meshes = contact_mesh(femur.mesh, femur.lateral), contact_mesh(button.mesh)
        return MeshContact(*meshes, self.law.build(), vector(button.origin), surface=surface, name=self.label)

    def _nearest(self, femur: FemurMesh, center: Floats, radius: float, surface: Surface | None) -> Contact:
        from pftwin.geometry.contact.patch_mesh import mesh_facets
        from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact

        facets, place = mesh_facets(femur.mesh, femur.lateral), vector(center)
        return MeshSphereContact(facets, self.law.build(), place, number(radius), surface=surface, name=self.label)

    def _volume(self, femur: FemurMesh, center: Floats, radius: float, surface: Surface | None) -> Contact:
        from pftwin.geometry.contact.patch_mesh import patch_mesh
        from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact

        made = patch_mesh(femur.mesh, radius, femur.lateral)
        effective = self.effective_radius_m or _measured_radius(femur, made, radius)
        place = vector(center), number(radius), number(effective)
        return MeshVolumeContact(made, self.law.build(), *place, surface=surface, name=self.label)


def _measured_radius(femur: FemurMesh, made: PatchMesh, radius: float) -> float:
    """Effective radius [m], measured beside the groove if the mesh has one."""
    from pftwin.geometry.contact.overlap import beside_groove, effective_radius

    near = None if femur.region is None else beside_groove(femur.mesh, femur.region, 0.5 * radius)
    return effective_radius(femur.mesh, made, radius, near)


class LayerSection(Section):
    """An elastic layer on a rigid base."""

    modulus_MPa: Positive = Field(description="elastic modulus [MPa]")
    poisson_ratio: Annotated[float, Field(ge=0, lt=0.5)] = Field(description="Poisson ratio, below 0.5 [-]")
    thickness_m: Positive = Field(description="thickness of the layer [m]")

    def build(self, where: str) -> Layer:
        """The layer."""
        from pftwin.model.effects.foundation_law import checked_layer

        return checked_layer(1e6 * self.modulus_MPa, self.poisson_ratio, self.thickness_m, where=where)


class ElasticFoundationSection(_MeshesSection):
    """Two meshes with an elastic foundation of two layers between them: pressure on every triangle in contact."""

    kind: ClassVar[str] = "elastic_foundation"
    law: Literal["linear", "logarithmic"] = Field(default="linear", description="pressure law of a layer")
    femur_layer: LayerSection = Field(description="table: the femur's layer, modulus_MPa, poisson_ratio, thickness_m")
    button_layer: LayerSection = Field(description="table: the button's layer")
    damping_time_s: NotNegative = Field(default=0.0, description="damping of a layer divided by its stiffness [s]")
    distance_grid_mm: Positive | None = Field(
        default=None,
        description="edge of the cubes of a table of depths [mm]: fast for contact between cartilages; with 1 mm the "
        "error is 0.007 mm (rms) there. By default depths are computed from the femur's triangles",
    )

    triangles_together: Annotated[int, Field(ge=1)] = Field(
        default=1,
        description="largest number of neighbouring triangles of the button to merge: faster, slightly less accurate",
    )

    button_turn_deg: Point | None = Field(
        default=None,
        description="rotation vector of the button's mesh about its frame's origin, patella frame [deg]; zeros make it "
        "a parameter to be fitted, absent it is none",
    )

    def build(self, setting: Setting) -> Effect:
        """The effect."""
        from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
        from pftwin.geometry.contact.distance_grid import distance_grid
        from pftwin.model.effects.elastic_foundation import ElasticFoundation
        from pftwin.model.effects.foundation_law import LAWS

        femur, surface = self.femur_side(setting)
        button = self.button.triangles(setting.at("button"))
        check_start(femur, button, setting)
        layers = self.femur_layer.build("femur_layer"), self.button_layer.build("button_layer")
        with setting.naming():
            if self.distance_grid_mm is None:
                pressed = pressed_surface(femur.mesh, femur.lateral)
            else:
                pressed = distance_grid(femur.mesh, 1e-3 * self.distance_grid_mm, femur.lateral)
            return ElasticFoundation(
                pressed,
                pressing_surface(button.mesh, self.triangles_together),
                LAWS[self.law](*layers),
                vector(button.origin),
                number(self.damping_time_s),
                surface=surface,
                turn=None if self.button_turn_deg is None else vector(self._turn(self.button_turn_deg, setting)),
                name=self.label,
            )

    def _turn(self, degrees: list[float], setting: Setting) -> Floats:
        """Rotation vector (3,) in the scene's axes [rad]; a mirrored rotation turns the other way."""
        axes = setting.points("patella", np.eye(3))
        return np.sign(np.linalg.det(axes)) * setting.points("patella", np.radians(degrees))
