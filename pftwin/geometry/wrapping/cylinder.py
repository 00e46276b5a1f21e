"""The taut line (shortest path) around a cylinder, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import Obstacle, TautLine, evenly, straight, where


class Cylinder(Obstacle):
    r"""An infinite cylinder.

    Seen along the axis the line is two tangents with an arc between them. Unrolled it is straight, so it has a constant
    slope along the axis: L^2 = (t1 + r theta + t2)^2 + dz^2. It wraps the nearer side or, if `side` is given, that
    side: then it never crosses the half-plane from the axis opposite to `side`, however long the way around.
    """

    radius: Scalar = eqx.field(metadata=quantity("m", positive=True))
    axis: Vec3  # of any length
    side: Vec3 | None = None  # of any length, not along the axis

    def around(self, start: Vec3, end: Vec3) -> TautLine:
        """See `Obstacle`."""
        axis, one, two, turn, arc, touches = self._wrapped(start, end)
        level = jnp.where(touches, one.tangent + self.radius * arc + two.tangent, 1.0)
        rise = two.height - one.height
        length = jnp.sqrt(jnp.square(level) + jnp.square(rise))

        def way(e: _End, turn: Scalar, rise: Scalar) -> Vec3:
            """Vector from an end to the tangent point, with the line's slope along the axis."""
            flat = axis.cross(e.across) * (turn * self.radius) - e.across * e.tangent
            return flat * (level / (length * e.squared)) + axis * (rise / length)

        wrapped = TautLine(length, way(one, turn, rise), way(two, -turn, -rise))
        return where(touches, wrapped, straight(start, end))

    def arc(self, start: Vec3, end: Vec3, count: int) -> Vec3:
        """See `Obstacle`: a helix, evenly divided."""
        axis, one, two, turn, arc, touches = self._wrapped(start, end)
        rise = (two.height - one.height) / (one.tangent + self.radius * arc + two.tangent)
        out = one.across * (1 / jnp.sqrt(one.squared))

        def at(share: Scalar) -> Vec3:
            angle, gone = one.reach + share * arc, one.tangent + self.radius * (share * arc)
            across = out * jnp.cos(angle) + axis.cross(out) * (turn * jnp.sin(angle))
            return self.center + across * self.radius + axis * (one.height + rise * gone)

        return evenly(at, count, touches)

    def depth(self, point: Vec3) -> Scalar:
        """See `Obstacle`."""
        return self.radius - (point - self.center).cross(self.axis).norm() / self.axis.norm()

    def _wrapped(self, start: Vec3, end: Vec3) -> tuple[Vec3, _End, _End, Scalar, Scalar, Scalar]:
        """Unit axis, both ends, sense of rotation (1: right-handed), angle of the arc [rad], whether the line wraps."""
        axis = self.axis * (1 / self.axis.norm())
        one, two = (self._end(p - self.center, axis) for p in (start, end))
        outside = one.outside & two.outside
        angle = self._angle(one.across, two.across, axis, outside)
        turn = jnp.where(angle < 0, -1.0, 1.0)
        arc = turn * angle - one.reach - two.reach
        return axis, one, two, turn, arc, outside & (arc > 0)

    def _end(self, point: Vec3, axis: Vec3) -> _End:
        height = point.dot(axis)
        across = point - axis * height
        squared, least = across.squared_norm(), jnp.square(self.radius)
        outside = squared > least
        squared = jnp.where(outside, squared, 2 * least)  # inside, anything with finite derivatives
        tangent = jnp.sqrt(squared - least)
        return _End(across, height, squared, tangent, jnp.arctan2(tangent, self.radius), outside)

    def _angle(self, start: Vec3, end: Vec3, axis: Vec3, outside: Scalar) -> Scalar:
        """Angle from start to end about the axis, right-handed [rad]; arbitrary if an end is inside the cylinder."""

        def between(a: Vec3, b: Vec3) -> Scalar:
            return jnp.arctan2(a.cross(b).dot(axis), jnp.where(outside, a.dot(b), 1.0))

        return between(start, end) if self.side is None else between(self.side, end) - between(self.side, start)


class _End(NamedTuple):
    """An end of the line relative to the cylinder."""

    across: Vec3  # from the axis, at right angles to it [m]
    height: Scalar  # along the axis [m]
    squared: Scalar  # its distance from the axis, squared [m^2]
    tangent: Scalar  # length of the tangent, seen along the axis [m]
    reach: Scalar  # angle about the axis from the end to where the tangent touches [rad]
    outside: Scalar
