"""wrap = { ... } in the tables of lines of force: the obstacle that they wrap over, one for all or one for each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.files.scene_file.section import (
    Directions,
    Points,
    Positives,
    PositiveTriples,
    Section,
    UnitQuaternions,
    group_size,
    member_values,
    problem,
)
from pftwin.files.scene_file.side import HostPose

if TYPE_CHECKING:
    from pftwin.files.scene_file.effect_tables import Setting
    from pftwin.geometry.wrapping.obstacle import Obstacle

_ALONG = 1e-3  # sine of the angle between side and axis below which the side is invalid
_LARGEST = 0.2  # [m] largest radius on a knee; a larger obstacle would contain all ends, so that lines are straight


def _check_sizes(name: str, sizes: np.ndarray) -> None:
    if sizes.max() > _LARGEST:
        raise problem(f"{name} is {sizes.max():g} m", expected=f"at most {_LARGEST:g} m, as of something on a bone")


class CylinderWrapSection(Section):
    """An infinite cylinder over which lines of force wrap; lists give each line its own."""

    type: Literal["cylinder"] = Field(description="kind of the obstacle")
    body: Literal["femur", "tibia", "patella"] = Field(description="bone to which it is fixed")
    center_m: Points = Field(description="a point on its axis, the bone's frame [m]")
    axis: Directions = Field(description="direction of its axis, the bone's frame")
    radius_m: Positives = Field(description="radius [m]")
    side: Directions | None = Field(
        default=None, description="side of the axis on which the lines pass, the bone's frame; by default the nearer"
    )

    @property
    def count(self) -> int:
        """How many obstacles there are."""
        return group_size(self, "center_m", "axis", "radius_m", "side")

    def _check(self) -> None:
        _check_sizes("radius_m", np.asarray(self.radius_m))
        axis, side = (np.broadcast_to(d, (self.count, 3)) for d in (self.axis, self.side or [[0.0, 0.0, 0.0]]))
        sine = np.linalg.norm(np.cross(axis, side), axis=1)
        along = sine <= _ALONG * np.linalg.norm(axis, axis=1) * np.linalg.norm(side, axis=1)
        if self.side is not None and along.any():
            raise problem(f"the side {side[along][0].tolist()} is along the axis", expected="a direction across it")

    def build(self, setting: Setting) -> Obstacle:
        """The obstacle."""
        from pftwin.geometry.wrapping.cylinder import Cylinder

        given = [self.center_m, self.axis, *([] if self.side is None else [self.side])]
        center, axis, *side = (
            vector(member_values(setting.points(self.body, np.asarray(points)), self.count)) for points in given
        )
        radius = number(member_values(np.asarray(self.radius_m), self.count))
        return Cylinder(center, self.body, radius, axis, *side)


class SphereWrapSection(Section):
    """A sphere over which lines of force wrap; lists give each line its own."""

    type: Literal["sphere"] = Field(description="kind of the obstacle")
    body: Literal["femur", "tibia", "patella"] = Field(description="bone to which it is fixed")
    center_m: Points = Field(description="centre, the bone's frame [m]")
    radius_m: Positives = Field(description="radius [m]")

    @property
    def count(self) -> int:
        """How many obstacles there are."""
        return group_size(self, "center_m", "radius_m")

    def _check(self) -> None:
        _check_sizes("radius_m", np.asarray(self.radius_m))
        assert self.count

    def build(self, setting: Setting) -> Obstacle:
        """The obstacle."""
        from pftwin.geometry.wrapping.sphere import Sphere

        center = vector(member_values(setting.points(self.body, np.asarray(self.center_m)), self.count))
        return Sphere(center, self.body, number(member_values(np.asarray(self.radius_m), self.count)))


class EllipsoidWrapSection(Section):
    """An ellipsoid over which lines of force wrap; lists give each line its own."""

    type: Literal["ellipsoid"] = Field(description="kind of the obstacle")
    body: Literal["femur", "tibia", "patella"] = Field(description="bone to which it is fixed")
    center_m: Points = Field(description="centre, the bone's frame [m]")
    radii_m: PositiveTriples = Field(description="radii along its axes [m]")
    quaternion_wxyz: UnitQuaternions = Field(
        default=[[1.0, 0.0, 0.0, 0.0]], description="orientation of its axes in the bone's frame (w, x, y, z)"
    )

    @property
    def count(self) -> int:
        """How many obstacles there are."""
        return group_size(self, "center_m", "radii_m", "quaternion_wxyz")

    def _check(self) -> None:
        _check_sizes("radii_m", np.asarray(self.radii_m))
        assert self.count

    def build(self, setting: Setting) -> Obstacle:
        """The obstacle. A mirrored one keeps a right-handed frame by reversing its z axis, which changes nothing."""
        from pftwin.geometry.wrapping.ellipsoid import Ellipsoid

        n, sign = self.count, -1.0 if setting.side.left else 1.0
        turns = []
        for quaternion in self.quaternion_wxyz:
            matrix = HostPose.of(np.zeros(3), quaternion).matrix
            axes = setting.side.matrices[self.body] @ matrix * np.array([1.0, 1.0, sign])
            turns.append(HostPose(np.zeros(3), axes).quaternion())
        center = vector(member_values(setting.points(self.body, np.asarray(self.center_m)), n))
        orientation = member_values(np.asarray(turns), n)
        turn = Quaternion(*(number(orientation[..., k]) for k in range(4)))
        return Ellipsoid(center, self.body, vector(member_values(np.asarray(self.radii_m), n)), turn)


Wrap = Annotated[CylinderWrapSection | SphereWrapSection | EllipsoidWrapSection, Field(discriminator="type")] | None
WRAP = Field(
    default=None,
    description="table: obstacle that the lines wrap over, "
    'type = "cylinder", "sphere" or "ellipsoid"; straight by default',
)


def obstacle(wrap: Wrap, lines: int, setting: Setting) -> Obstacle | None:
    """The obstacle of a number of lines; `setting` is that of their table.

    Raises:
        InputError: a number of obstacles that is neither 1 nor that of the lines.
    """
    if wrap is None:
        return None
    if wrap.count not in (1, lines):
        expected = f"1 or {lines}" if lines > 1 else "1"
        raise InputError(f"{wrap.count} obstacles for {lines} lines", where=setting.where("wrap"), expected=expected)
    return wrap.build(setting)
