"""Straight lines of force between the patella and a guided body: the geometry that tendons and ligaments share."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.effects.base import Effect, Instant, StiffTerm, applied_at
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


class _Fixed(Protocol):
    """What is fixed to the patella."""

    @property
    def insertion(self) -> Vec3: ...


class _Stretched(_Fixed, Protocol):
    """What runs from there to a point of a guided body."""

    @property
    def origin(self) -> Vec3: ...

    @property
    def body(self) -> str: ...


_Any = TypeVar("_Any", bound=_Fixed)


class PatellaEnd(Effect):
    """An effect with a field `insertion`: its point of the patella, patella frame [m], or one for each line of a group.

    The field is the subclass's, in its own place among the others: not declared here, where it would come first.
    """

    def about(self: _Any, center_of_mass: Vec3) -> _Any:
        """Insertions counted from the centre of mass."""
        return eqx.tree_at(lambda t: t.insertion, self, self.insertion - center_of_mass)


class Strung(PatellaEnd):
    """An effect along the line from its insertion to its `origin`, a point of the guided `body` [m]."""

    def line(self: _Stretched, now: Instant) -> Line:
        """Where it runs."""
        return line_of_force(now, self.insertion, self.body, self.origin)
