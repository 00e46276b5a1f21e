"""The taut line (shortest path) around a sphere, in closed form."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.circle import AroundCircle, Tangent, angle_about
from pftwin.geometry.wrapping.obstacle import Obstacle, TautLine, evenly, straight, where


class Sphere(Obstacle):
    r"""A sphere.

    The line lies in the plane of its ends and the centre: two tangents with an arc of a great circle between them, on
    the side of the centre on which the straight line passes.
    """

    radius: Scalar = eqx.field(metadata=quantity("m", positive=True))

    def around(self, start: Vec3, end: Vec3) -> TautLine:
        """See `Obstacle`."""
        circle = self._circle(start, end)
        return where(circle.touches, circle.line(), straight(start, end))

    def arc(self, start: Vec3, end: Vec3, count: int) -> Vec3:
        """See `Obstacle`: an arc of a great circle, evenly divided."""
        circle = self._circle(start, end)
        return evenly(lambda share: self.center + circle.point(share), count, circle.touches)

    def depth(self, point: Vec3) -> Scalar:
        """See `Obstacle`."""
        return self.radius - (point - self.center).norm()

    def _circle(self, start: Vec3, end: Vec3) -> AroundCircle:
        one, two = (Tangent.of(p - self.center, self.radius) for p in (start, end))
        axis = _normal(one, two)
        return AroundCircle.of(one, two, axis, angle_about(axis, one.across, two.across, one.outside & two.outside))


def _normal(one: Tangent, two: Tangent) -> Vec3:
    """Unit normal of the plane of the ends and the centre; of some plane if rounding decides on it."""
    cross = one.across.cross(two.across)
    squared = cross.squared_norm()
    plane = squared > jnp.finfo(squared.dtype).eps * one.squared * two.squared
    size = jnp.sqrt(jnp.where(plane, squared, 1.0))
    any_plane = (one.across * (1 / jnp.sqrt(one.squared))).perpendiculars()[0]
    pairs = ((cross.x, any_plane.x), (cross.y, any_plane.y), (cross.z, any_plane.z))
    return Vec3(*(jnp.where(plane, component / size, other) for component, other in pairs))
