"""The taut line (shortest path) around a cylinder, in closed form."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.circle import AroundCircle, Tangent, angle_about
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
        circle, heights = self._in_cross_section(start, end)
        flat, axis = circle.line(), circle.axis
        level, rise = jnp.where(circle.touches, flat.length, 1.0), heights[1] - heights[0]
        length = jnp.sqrt(jnp.square(level) + jnp.square(rise))
        run, up = level / length, axis * (rise / length)
        wrapped = TautLine(length, flat.at_start * run + up, flat.at_end * run - up)
        return where(circle.touches, wrapped, straight(start, end))

    def arc(self, start: Vec3, end: Vec3, count: int) -> Vec3:
        """See `Obstacle`: a helix, evenly divided."""
        circle, heights = self._in_cross_section(start, end)
        rise = (heights[1] - heights[0]) / circle.line().length

        def at(share: Scalar) -> Vec3:
            distance = circle.one.length + self.radius * (share * circle.arc)
            return self.center + circle.point(share) + circle.axis * (heights[0] + rise * distance)

        return evenly(at, count, circle.touches)

    def depth(self, point: Vec3) -> Scalar:
        """See `Obstacle`."""
        return self.radius - (point - self.center).cross(self.axis).norm() / self.axis.norm()

    def _in_cross_section(self, start: Vec3, end: Vec3) -> tuple[AroundCircle, list[Scalar]]:
        """The line seen along the axis, and the heights of its ends along the axis from the centre [m]."""
        axis = self.axis * (1 / self.axis.norm())
        ends = [p - self.center for p in (start, end)]
        heights = [p.dot(axis) for p in ends]
        one, two = (Tangent.of(p - axis * height, self.radius) for p, height in zip(ends, heights, strict=True))
        return AroundCircle.of(one, two, axis, self._angle(one, two, axis)), heights

    def _angle(self, one: Tangent, two: Tangent, axis: Vec3) -> Scalar:
        outside = one.outside & two.outside
        if self.side is None:
            return angle_about(axis, one.across, two.across, outside)
        from_start, from_end = (angle_about(axis, self.side, t.across, outside) for t in (one, two))
        return from_end - from_start
