"""The taut line around a circle in its plane: two tangents with an arc between them."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import TautLine


class Tangent(NamedTuple):
    """A tangent to a circle from an end of the line in the circle's plane."""

    across: Vec3  # from the circle's centre to the end [m]
    squared: Scalar  # its length squared [m^2]
    radius: Scalar  # of the circle [m]
    length: Scalar  # of the tangent [m]
    angle: Scalar  # angle about the centre from the end to where the tangent touches [rad]
    outside: Scalar  # whether the end is outside the circle; from inside, the numbers are arbitrary

    @staticmethod
    def of(across: Vec3, radius: Scalar) -> Tangent:
        """The tangent from an end, of either sense."""
        squared, least = across.squared_norm(), jnp.square(radius)
        outside = squared > least
        squared = jnp.where(outside, squared, 2 * least)  # inside, anything with finite derivatives
        length = jnp.sqrt(squared - least)
        return Tangent(across, squared, radius, length, jnp.arctan2(length, radius), outside)

    def way(self, axis: Vec3, turn: Scalar) -> Vec3:
        """Unit vector along the tangent that goes on around the circle, right-handed about `axis` if `turn` is 1."""
        return (axis.cross(self.across) * (turn * self.radius) - self.across * self.length) * (1 / self.squared)


class AroundCircle(NamedTuple):
    """A line in a circle's plane: two tangents with an arc between them."""

    one: Tangent  # from the start
    two: Tangent  # from the end
    axis: Vec3  # unit vector at right angles to the plane
    turn: Scalar  # sense of rotation from start to end: 1 if right-handed about the axis, else -1
    arc: Scalar  # angle of the arc [rad]; not positive if the straight line passes beside the circle

    @staticmethod
    def of(one: Tangent, two: Tangent, axis: Vec3, angle: Scalar) -> AroundCircle:
        """`angle` is that from start to end about the axis on the line's side of the centre, right-handed [rad]."""
        turn = jnp.where(angle < 0, -1.0, 1.0)
        return AroundCircle(one, two, axis, turn, turn * angle - one.angle - two.angle)

    @property
    def touches(self) -> Scalar:
        """Whether the line touches the circle."""
        return self.one.outside & self.two.outside & (self.arc > 0)

    def line(self) -> TautLine:
        """The line if it touches."""
        one, two, axis, turn = self.one, self.two, self.axis, self.turn
        return TautLine(one.length + one.radius * self.arc + two.length, one.way(axis, turn), two.way(axis, -turn))

    def point(self, share: Scalar) -> Vec3:
        """Point on the arc at a share of it from the start's side, from the circle's centre [m]."""
        out, angle = self.one.across * (1 / jnp.sqrt(self.one.squared)), self.one.angle + share * self.arc
        return (out * jnp.cos(angle) + self.axis.cross(out) * (self.turn * jnp.sin(angle))) * self.one.radius


def angle_about(axis: Vec3, start: Vec3, end: Vec3, outside: Scalar) -> Scalar:
    """Angle from start to end about an axis, right-handed [rad]; something finite if not `outside`."""
    return jnp.arctan2(start.cross(end).dot(axis), jnp.where(outside, start.dot(end), 1.0))
