"""[elastic_foundation]: the button's mesh on the femur's, each with an elastic layer."""

# ruff: noqa: N815  (units in names are written as units are: MPa)
from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.effect_tables import EffectSection
from pftwin.files.scene_file.mesh_tables import At, ButtonSection, FemurMeshSection, check_start, refuse_patch
from pftwin.files.scene_file.section import NotNegative, Positive, Section
from pftwin.files.scene_file.setting import Setting
from pftwin.files.scene_file.surface_table import SurfaceSection

if TYPE_CHECKING:
    from pftwin.model.effects.base import Effect
    from pftwin.model.effects.foundation_law import Layer


class LayerSection(Section):
    """An elastic layer on a rigid backing."""

    modulus_MPa: Positive = Field(description="elastic modulus [MPa]")
    poisson_ratio: Annotated[float, Field(ge=0, lt=0.5)] = Field(description="Poisson ratio, below 0.5 [-]")
    thickness_m: Positive = Field(description="thickness of the layer [m]")

    def build(self, where: str) -> Layer:
        """The layer."""
        from pftwin.model.effects.foundation_law import checked_layer

        return checked_layer(1e6 * self.modulus_MPa, self.poisson_ratio, self.thickness_m, where=where)


class ElasticFoundationSection(EffectSection):
    """Two meshes with a layered elastic foundation between them: pressure on every triangle in contact."""

    kind: ClassVar[str] = "elastic_foundation"
    law: Literal["linear", "logarithmic"] = Field(default="linear", description="pressure over depth of a layer")
    femur: FemurMeshSection = Field(description="table: the femur's mesh")
    button: ButtonSection = Field(description="table: the button, mesh or sphere")
    femur_layer: LayerSection = Field(description="table: the femur's layer, modulus_MPa, poisson_ratio, thickness_m")
    button_layer: LayerSection = Field(description="table: the button's layer")
    damping_time_s: NotNegative = Field(default=0.0, description="damping of a layer over its stiffness [s]")
    surface: SurfaceSection | None = Field(
        default=None, description="table: a smooth surface by which results tell where the groove is; none by default"
    )

    def build(self, setting: Setting, at: At) -> Effect:
        """The effect."""
        from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
        from pftwin.model.effects.elastic_foundation import ElasticFoundation
        from pftwin.model.effects.foundation_law import LAWS

        refuse_patch(setting, at)
        surface = None if self.surface is None else self.surface.build(setting, (*at, "surface"))
        femur = self.femur.build(setting, (*at, "femur"))
        button = self.button.triangles(setting, (*at, "button"))
        check_start(femur, button, setting, at)
        layers = self.femur_layer.build("femur_layer"), self.button_layer.build("button_layer")
        with setting.document.naming(*at):
            return ElasticFoundation(
                pressed_surface(femur.mesh, femur.lateral),
                pressing_surface(button.mesh),
                LAWS[self.law](*layers),
                vector(button.origin),
                number(self.damping_time_s),
                surface=surface,
                name=self.label,
            )
