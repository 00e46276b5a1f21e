"""What the tables of all effects share, the setting they are built in, and [gravity] and [damping]."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.section import Name, NotNegative, Point, Section
from pftwin.files.scene_file.side import HostPose, Side
from pftwin.model.effects.base import Effect
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.gravity import Gravity
from pftwin.model.motion import KneeMotion

if TYPE_CHECKING:
    from pftwin.geometry.patch.sphere import SphereFit


@dataclass(frozen=True)
class Setting:
    """What an effect's table needs to become an effect."""

    document: Document
    side: Side
    mass: float  # of the patella [kg]
    motion: KneeMotion
    fixed_femur: HostPose | None  # its pose in the world (mirrored); the scene's world is then the femur's frame
    start: HostPose  # the patella's frame in the femur's at the first frame
    contact: str | None = None  # polynomial asked for on the command line, in place of the file's
    buttons: dict[str, SphereFit] = field(default_factory=dict)  # fitted spheres by contact, patella frame
    notes: list[str] = field(default_factory=list)  # for the user to read

    def path(self, name: str) -> str:
        """A file's path; relative ones start at the scene file.

        Raises:
            InputError: it leads out of the scene's folder, and that is not allowed.
        """
        return str(self.document.file(name))

    def points(self, frame: str, values: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of a body's frame, mirrored where the knee is a left one, in the scene's frames."""
        mirrored = self.side.points(frame, values)
        if frame == "ground" and self.fixed_femur is not None:
            return self.fixed_femur.inverse().apply(mirrored)
        return mirrored

    def world_direction(self, values: ArrayLike) -> NDArray[np.float64]:
        """A direction of the world in the scene's world."""
        mirrored = self.side.points("world", values)
        return mirrored if self.fixed_femur is None else mirrored @ self.fixed_femur.matrix


Body = Literal["femur", "tibia", "ground"]


class EffectSection(Section):
    """A table that becomes an effect. `kind` is the table's name; effects go by it where they have no name."""

    kind: ClassVar[str]
    name: Name | None = Field(default=None, description="name of the effect in results; the table's name by default")

    @property
    def label(self) -> str:
        """The effect's name."""
        return self.name or self.kind

    @abstractmethod
    def build(self, setting: Setting, at: tuple[str | int, ...]) -> Effect:
        """The effect; `at` is the table's place in the file.

        Raises:
            InputError: files that cannot be used, groups of unlike lengths.
        """


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
