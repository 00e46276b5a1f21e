"""[gravity] and [damping]: loads on the whole patella."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.effect_tables import Body, EffectSection
from pftwin.files.scene_file.section import NotNegative, Point
from pftwin.files.scene_file.setting import Setting
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.gravity import Gravity


class GravitySection(EffectSection):
    """The patella's weight."""

    kind: ClassVar[str] = "gravity"
    acceleration_m_per_s2: Point = Field(description="acceleration of gravity in the world [m/s^2]")

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> Gravity:
        """The effect."""
        acceleration = setting.world_direction(self.acceleration_m_per_s2)
        return Gravity(number(setting.mass), vector(acceleration), name=self.label)


class DampingSection(EffectSection):
    """Linear viscous damping of the patella's motion."""

    kind: ClassVar[str] = "damping"
    translational_N_s_per_m: NotNegative = Field(description="damping of translation [N s/m]")
    rotational_N_m_s_per_rad: NotNegative = Field(description="damping of rotation [N m s/rad]")
    body: Body = Field(default="femur", description="body relative to which the motion is damped")

    def build(self, setting: Setting, at: tuple[str | int, ...]) -> LinearDamping:
        """The effect."""
        rates = number(self.translational_N_s_per_m), number(self.rotational_N_m_s_per_rad)
        return LinearDamping(*rates, body=self.body, name=self.label)
