"""[contact]: the button's sphere on the trochlea, with the laws of normal force and friction.

The tables of laws and friction are also used in [mesh_contact].
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pftwin.base.arrays import Floats
from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.effect_tables import EffectSection, Setting
from pftwin.files.scene_file.section import FileName, LengthUnit, NotNegative, Point, Positive, Section, problem
from pftwin.files.scene_file.surface_table import SurfaceSection
from pftwin.model.effects.base import Effect
from pftwin.model.effects.contact import Contact
from pftwin.model.effects.contact_law import Flores, Hertz, HuntCrossley
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.sphere_contact import SphereContact


class LawSection(Section):
    """Normal force F = k d^p (1 + x dd/dt) at an indentation d."""

    contact_stiffness: Positive = Field(description="stiffness k [N/m^p], p the hertz_exponent")
    hertz_exponent: Annotated[float, Field(ge=1, le=5)] = Field(default=1.5, description="exponent p [-]")


class FloresSection(LawSection):
    """Flores et al. 2011."""

    type: Literal["flores"]
    restitution: Annotated[float, Field(gt=0, le=1)] = Field(description="coefficient of restitution, 0 to 1 [-]")
    approach_speed_floor_m_per_s: Positive = Field(default=0.01, description="least approach speed in the law [m/s]")

    def build(self) -> Flores:
        """The law."""
        return Flores(
            number(self.contact_stiffness),
            number(self.restitution),
            hertz_exponent=self.hertz_exponent,
            approach_speed_floor=self.approach_speed_floor_m_per_s,
        )


class HuntCrossleySection(LawSection):
    """Hunt and Crossley 1975."""

    type: Literal["hunt_crossley"]
    dissipation_s_per_m: NotNegative = Field(description="dissipation alpha [s/m]")

    def build(self) -> HuntCrossley:
        """The law."""
        stiffness, dissipation = number(self.contact_stiffness), number(self.dissipation_s_per_m)
        return HuntCrossley(stiffness, dissipation, hertz_exponent=self.hertz_exponent)


class HertzSection(LawSection):
    """Hertz, without dissipation."""

    type: Literal["hertz"]

    def build(self) -> Hertz:
        """The law."""
        return Hertz(number(self.contact_stiffness), hertz_exponent=self.hertz_exponent)


Law = Annotated[FloresSection | HuntCrossleySection | HertzSection, Field(discriminator="type")]
LAW = Field(description='table: the normal force\'s law, type = "flores", "hunt_crossley" or "hertz"')


class ButtonSection(Section):
    """A button by its mesh, in the patella's frame."""

    mesh: FileName = Field(description="STL, OBJ or PLY file of the patellar button")
    units: LengthUnit = Field(description="unit of the mesh's coordinates")
    tolerance_m: Positive = Field(default=0.02e-3, description="largest deviation of the spherical part [m]")

    def sphere(self, setting: Setting, label: str) -> tuple[Floats, float]:
        """See `Setting.sphere`."""
        from pftwin.geometry.mesh.mesh import load_mesh

        with setting.naming("mesh"):
            mesh = load_mesh(setting.path(self.mesh), units=self.units)
        return setting.sphere(mesh, label, self.tolerance_m)


class FrictionSection(Section):
    """Coulomb friction, regularized at low sliding speed."""

    coefficient: NotNegative = Field(description="coefficient of friction mu [-]")
    slip_speed_m_per_s: Positive = Field(
        default=1e-3, description="sliding speed below which friction is regularized: contacts creep [m/s]"
    )

    def added(self, contact: Contact) -> Contact:
        """The contact with friction."""
        return contact.with_friction(Friction(number(self.coefficient), number(self.slip_speed_m_per_s)))


class ContactSection(EffectSection):
    """A sphere fixed in the patella on a surface fixed in the femur."""

    kind: ClassVar[str] = "contact"
    center_m: Point = Field(default=[0.0, 0.0, 0.0], description="centre of the button's sphere, patella frame [m]")
    radius_m: Positive | None = Field(default=None, description="radius of the button's sphere [m]; or a button")
    button: ButtonSection | None = Field(default=None, description="table: a mesh that the sphere is fitted to")
    surface: SurfaceSection = Field(description="table: a mesh to fit, coefficients, or an implant")
    law: Law = LAW
    friction: FrictionSection | None = Field(default=None, description="table: friction; none by default")

    def _check(self) -> None:
        if self.radius_m is None and self.button is None:
            raise problem("the sphere has no radius", expected="radius_m and center_m, or button")
        if self.button is not None and {"radius_m", "center_m"} & self.model_fields_set:
            raise problem("both button and radius_m or center_m are given", expected="one of them")

    def build(self, setting: Setting) -> Effect:
        """The effect."""
        surface = self.surface.build(setting.at("surface"))
        center, radius = setting.points("patella", self.center_m), self.radius_m
        if self.button is not None:
            center, radius = self.button.sphere(setting.at("button"), self.label)
        assert radius is not None
        contact = SphereContact(surface, self.law.build(), vector(center), number(radius), name=self.label)
        return contact if self.friction is None else self.friction.added(contact)
