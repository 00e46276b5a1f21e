"""[contact]: the button's sphere on the trochlea, and its normal force's law."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pftwin.effects.contact_law import Flores, Hertz, HuntCrossley
from pftwin.effects.sphere_contact import SphereContact
from pftwin.scene_file.effect_tables import EffectSection
from pftwin.scene_file.host_pose import scalar, vector
from pftwin.scene_file.section import NotNegative, Point, Positive, Section
from pftwin.scene_file.setting import Setting
from pftwin.scene_file.surface_table import SurfaceSection


class LawSection(Section):
    """F = k d^p (1 + x dd/dt)."""

    contact_stiffness: Positive = Field(description="stiffness k [N/m^p], p the hertz_exponent")
    hertz_exponent: Annotated[float, Field(ge=1, le=5)] = Field(1.5, description="exponent p [-]")


class FloresSection(LawSection):
    """Flores et al. 2011."""

    type: Literal["flores"]
    restitution: Annotated[float, Field(gt=0, le=1)] = Field(description="coefficient of restitution, 0 to 1 [-]")
    approach_speed_floor_m_per_s: Positive = Field(0.01, description="least approach speed reckoned with [m/s]")

    def build(self) -> Flores:
        """The law."""
        return Flores(
            scalar(self.contact_stiffness),
            scalar(self.restitution),
            hertz_exponent=self.hertz_exponent,
            approach_speed_floor=self.approach_speed_floor_m_per_s,
        )


class HuntCrossleySection(LawSection):
    """Hunt and Crossley 1975."""

    type: Literal["hunt_crossley"]
    dissipation_s_per_m: NotNegative = Field(description="dissipation alpha [s/m]")

    def build(self) -> HuntCrossley:
        """The law."""
        stiffness, dissipation = scalar(self.contact_stiffness), scalar(self.dissipation_s_per_m)
        return HuntCrossley(stiffness, dissipation, hertz_exponent=self.hertz_exponent)


class HertzSection(LawSection):
    """Hertz, without loss."""

    type: Literal["hertz"]

    def build(self) -> Hertz:
        """The law."""
        return Hertz(scalar(self.contact_stiffness), hertz_exponent=self.hertz_exponent)


class ContactSection(EffectSection):
    """A sphere fixed in the patella on a surface fixed in the femur."""

    kind: ClassVar[str] = "contact"
    center_m: Point = Field([0.0, 0.0, 0.0], description="centre of the button's sphere, patella frame [m]")
    radius_m: Positive = Field(description="radius of the button's sphere [m]")
    surface: SurfaceSection = Field(description="table: mesh to be fitted, coefficients, or implant")
    law: Annotated[FloresSection | HuntCrossleySection | HertzSection, Field(discriminator="type")] = Field(
        description='table: the normal force\'s law, type = "flores", "hunt_crossley" or "hertz"'
    )

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> SphereContact:
        """The effect."""
        surface = self.surface.build(setting, (*at, "surface"))
        center = vector(setting.points("patella", self.center_m))
        return SphereContact(surface, self.law.build(), center, scalar(self.radius_m), name=self.label)
