"""wrap = { ... } in the tables of lines of force: the obstacle that they run over."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pftwin.base.leaves import number, vector
from pftwin.files.scene_file.section import Direction, Point, Positive, Section, problem

if TYPE_CHECKING:
    from pftwin.files.scene_file.effect_tables import Setting
    from pftwin.geometry.wrapping.obstacle import Obstacle

_ALONG = 1e-3  # sine of an angle below which a side is no side


class CylinderWrapSection(Section):
    """An endless cylinder that lines of force run over where they touch it."""

    type: Literal["cylinder"] = Field(description="what the obstacle is")
    body: Literal["femur", "tibia", "patella"] = Field(description="bone that carries it")
    center_m: Point = Field(description="a point of its axis, the bone's frame [m]")
    axis: Direction = Field(description="direction of its axis, the bone's frame")
    radius_m: Positive = Field(description="radius [m]")
    side: Direction | None = Field(
        default=None, description="side of the axis on which the lines pass, the bone's frame; the nearer by default"
    )

    @model_validator(mode="after")
    def _aside(self) -> Self:
        if self.side is not None:
            sine = np.linalg.norm(np.cross(self.axis, self.side))
            if sine < _ALONG * np.linalg.norm(self.axis) * np.linalg.norm(self.side):
                raise problem(f"the side {self.side} is along the axis", expected="a direction across it")
        return self

    def build(self, setting: Setting) -> Obstacle:
        """The obstacle."""
        from pftwin.geometry.wrapping.cylinder import Cylinder

        center = vector(setting.points(self.body, self.center_m))
        axis, side = (None if d is None else vector(setting.points(self.body, d)) for d in (self.axis, self.side))
        return Cylinder(center, self.body, number(self.radius_m), axis, side)


Wrap = CylinderWrapSection | None
WRAP = Field(default=None, description="table: an obstacle that the lines run over; straight by default")
