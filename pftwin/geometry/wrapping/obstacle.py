"""Convex obstacles on a body, and the taut line around one from a point to another."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3


class TautLine(NamedTuple):
    """The shortest line from a start to an end that does not pass through an obstacle.

    The gradient of its length with respect to an end is minus the direction there.
    """

    length: Scalar  # [m]
    at_start: Vec3  # unit, from the start along the line
    at_end: Vec3  # unit, from the end back along the line


class Obstacle(eqx.Module):
    """A convex obstacle fixed to a body, over which muscle and ligament lines wrap."""

    center: Vec3 = eqx.field(metadata=quantity("m", frame="obstacle's body"))
    body: str = eqx.field(static=True)  # "femur", "tibia" or "patella"

    @abstractmethod
    def around(self, start: Vec3, end: Vec3) -> TautLine:
        """The taut line between points of the body's frame [m], or arrays of them; straight if a point is inside."""

    @abstractmethod
    def arc(self, start: Vec3, end: Vec3, count: int) -> Vec3:
        """`count` points of the taut line on the obstacle, for drawings: along a new first axis, from the first point
        at which the line touches to the last; NaN where the line is straight."""

    @abstractmethod
    def depth(self, point: Vec3) -> Scalar:
        """Lower bound on the depth of a point of the body's frame inside [m]; not positive for a point outside."""


def evenly(at: Callable[[Scalar], Vec3], count: int, touches: Scalar) -> Vec3:
    """Points `at` numbers from 0 to 1, `count` of them, along a new first axis; NaN where a condition is false."""
    points = jax.vmap(at)(jnp.linspace(0.0, 1.0, count))
    return jax.tree.map(lambda c: jnp.where(touches[None], c, jnp.nan), points)


def straight(start: Vec3, end: Vec3) -> TautLine:
    """The straight line; directions are zero, with finite derivatives, if the points coincide."""
    line = end - start
    length = line.norm()
    way = line * (1 / jnp.where(length > 1e-9, length, 1e-9))
    return TautLine(length, way, -way)


def where(condition: Scalar, one: TautLine, other: TautLine) -> TautLine:
    """Selects one line where a condition is true, else the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)
