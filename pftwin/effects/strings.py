"""Straight lines of force between the patella and a guided body: the geometry that tendons and ligaments share."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.effects.base import Instant, StiffTerm, applied_at
from pftwin.spatial import Scalar, Vec3


class Line(NamedTuple):
    """A line from the patella's insertion to the origin on a guided body."""

    length: Scalar  # [m]
    lengthening: Scalar  # d length / dt [m/s]
    direction: Vec3  # from the insertion to the origin, world
    moment: Vec3  # of a unit pull about the patella's centre of mass, patella axes [m]

    def term(self, tension: Scalar, elastic: Scalar, stiffness: Scalar, damping: Scalar) -> StiffTerm:
        """The pull along this line as a stiff term."""
        return StiffTerm(self.direction, self.moment, tension, elastic, stiffness, damping, self.lengthening)


def line_of_force(now: Instant, insertion: Vec3, body: str, origin: Vec3) -> Line:
    """The line between the patella's point `insertion` and the point `origin` of `body`.

    Where the two points coincide the direction is the zero vector, with finite derivatives.
    """
    patella, segment = now.patella, now.segment(body)
    arm = patella.arm(insertion)
    anchor = segment.point(origin)
    line = anchor - (patella.position + arm)
    length = line.norm()
    direction = line * (1 / _at_least(length))
    velocity = segment.relative_velocity(patella.velocity_at(arm), anchor)
    return Line(length, -direction.dot(velocity), direction, applied_at(insertion, patella, direction))


def _at_least(length: Scalar, least: float = 1e-9) -> Scalar:
    """Keeps a division finite, in value and in derivative, where a line has no length."""
    return jnp.where(length > least, length, least)
