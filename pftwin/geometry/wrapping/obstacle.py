"""Convex obstacles on a body, and the taut line around one from a point to another."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3


class TautLine(NamedTuple):
    """The shortest line from a start to an end that does not pass through an obstacle.

    Its length changes by minus each direction times the displacement of that end.
    """

    length: Scalar  # [m]
    at_start: Vec3  # unit, from the start along the line
    at_end: Vec3  # unit, from the end back along the line


class Obstacle(eqx.Module):
    """Something fixed to a body that lines of force run over where they touch it."""

    center: Vec3 = eqx.field(metadata=quantity("m", frame="obstacle's body"))
    body: str = eqx.field(static=True)  # "femur", "tibia" or "patella"

    @abstractmethod
    def around(self, start: Vec3, end: Vec3) -> TautLine:
        """The taut line between points of the body's frame [m], or between many; straight from a point inside."""

    @abstractmethod
    def depth(self, point: Vec3) -> Scalar:
        """How deep a point of the body's frame lies within, at least [m]; not positive for one outside."""


def straight(start: Vec3, end: Vec3) -> TautLine:
    """The line past an obstacle; where the points coincide its directions are zero, with finite derivatives."""
    line = end - start
    length = line.norm()
    way = line * (1 / jnp.where(length > 1e-9, length, 1e-9))
    return TautLine(length, way, -way)


def where(condition: Scalar, one: TautLine, other: TautLine) -> TautLine:
    """One line where a condition holds, the other elsewhere."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)
