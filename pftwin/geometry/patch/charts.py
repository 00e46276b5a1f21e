"""Charts: maps from two surface coordinates and a height to points in space.

A chart has its own frame, fixed in the femur. Coordinates (u, v, height) are in metres in both charts: u along the
groove, v medial-lateral, height out of the bone.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Rotation, Scalar, Vec3

WIDEST = 0.5  # angle about a cylinder's axis within which a tangent approximates the surface [rad]


class Jet(NamedTuple):
    """A height with its first and second derivatives with respect to (u, v)."""

    f: Scalar
    u: Scalar
    v: Scalar
    uu: Scalar
    uv: Scalar
    vv: Scalar

    def slopes_beside(self, du: Scalar, dv: Scalar) -> tuple[Scalar, Scalar]:
        """Slopes at (u + du, v + dv) by their linear expansion."""
        return self.u + self.uu * du + self.uv * dv, self.v + self.uv * du + self.vv * dv


class Separation(NamedTuple):
    """Derivatives of phi(u, v), half the squared distance from a point to the surface, and the surface's tangents."""

    gradient: tuple[Scalar, Scalar]
    hessian: tuple[Scalar, Scalar, Scalar]  # uu, uv, vv
    gram: tuple[Scalar, Scalar, Scalar]  # scalar products of the tangents: the Hessian's positive definite part
    tangents: tuple[Vec3, Vec3]


class FramedChart(eqx.Module):
    """Base class of charts, with a frame fixed in the femur."""

    origin: Vec3 = eqx.field(metadata=quantity("m", frame="femur"))
    axes: Rotation  # chart frame to femur frame; z points out of the bone

    @property
    def axis_radius(self) -> Scalar | None:
        """Radius at which u measures the angle about an axis [m]; None for a chart that goes round none."""
        return None

    def to_frame(self, p: Vec3) -> Vec3:
        """Transforms a point from the femur's frame to the chart's [m]."""
        return self.axes.unapply(p - self.origin)

    def from_frame(self, p: Vec3) -> Vec3:
        """Transforms a point from the chart's frame to the femur's [m]."""
        return self.origin + self.axes.apply(p)

    def point(self, u: Scalar, v: Scalar, height: Scalar) -> Vec3:
        """Point with these chart coordinates, in the femur's frame [m]."""
        return self.from_frame(self.local_point(u, v, height))

    @abstractmethod
    def local_point(self, u: Scalar, v: Scalar, height: Scalar) -> Vec3:
        """Point with these chart coordinates, in the chart's frame [m]."""


class PlaneChart(FramedChart):
    """Heights over a plane, as in the paper (section 2.4.2): (u, v, height) are x, y, z of the chart's frame."""

    def coordinates(self, p: Vec3) -> Vec3:
        """(u, v, height) of a point given in the femur frame."""
        return self.to_frame(p)

    def local_point(self, u: Scalar, v: Scalar, height: Scalar) -> Vec3:
        """The same in the chart's own frame."""
        return Vec3(u, v, height)

    def foot(self, c: Vec3) -> tuple[Scalar, Scalar]:
        """(u, v) straight below a point given in the chart's frame."""
        return c.x, c.y

    def longest_along(self, longest: Scalar) -> Scalar:
        """The longest step of u that moves a point by no more than a given length [m]."""
        return longest

    def normal(self, u: Scalar, f: Scalar, slope_u: Scalar, slope_v: Scalar) -> Vec3:
        """Unit outward normal, chart frame."""
        k = 1 / jnp.sqrt(1 + slope_u * slope_u + slope_v * slope_v)
        return Vec3(-slope_u * k, -slope_v * k, k)

    def half_square(self, c: Vec3, u: Scalar) -> Callable[[Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]:
        """phi and its derivative along u, as a function of (v, height, slope along u) at one u."""
        du = u - c.x

        def at(v: Scalar, f: Scalar, slope: Scalar) -> tuple[Scalar, Scalar]:
            gap, dv = f - c.z, v - c.y
            return 0.5 * (du * du + dv * dv + gap * gap), du + gap * slope

        return at

    def separation(self, c: Vec3, u: Scalar, v: Scalar, jet: Jet) -> Separation:
        """Derivatives of phi = |S(u, v) - c|^2 / 2 for a point c of the chart's frame."""
        gap = jet.f - c.z
        gram = 1 + jet.u * jet.u, jet.u * jet.v, 1 + jet.v * jet.v
        one, zero = jnp.ones_like(jet.u), jnp.zeros_like(jet.u)
        return Separation(
            ((u - c.x) + gap * jet.u, (v - c.y) + gap * jet.v),
            (gram[0] + gap * jet.uu, gram[1] + gap * jet.uv, gram[2] + gap * jet.vv),
            gram,
            (Vec3(one, zero, jet.u), Vec3(zero, one, jet.v)),
        )


class CylindricalChart(FramedChart):
    """Heights over a cylinder about the trochlear axis, the chart's y: does not fold over in deep flexion.

    u = radius * atan2(x, z), v = y, height = distance from the axis.
    """

    radius: Scalar = eqx.field(metadata=quantity("m", positive=True))  # makes the angle a length

    @property
    def axis_radius(self) -> Scalar:
        """See `FramedChart`."""
        return self.radius

    def coordinates(self, p: Vec3) -> Vec3:
        """(u, v, height) of a point given in the femur frame."""
        q = self.to_frame(p)
        u, v = self.foot(q)
        return Vec3(u, v, jnp.sqrt(q.x * q.x + q.z * q.z))

    def local_point(self, u: Scalar, v: Scalar, height: Scalar) -> Vec3:
        """The same in the chart's own frame."""
        angle = u / self.radius
        return Vec3(height * jnp.sin(angle), v, height * jnp.cos(angle))

    def foot(self, c: Vec3) -> tuple[Scalar, Scalar]:
        """(u, v) radially below a point given in the chart's frame."""
        return self.radius * jnp.arctan2(c.x, c.z), c.y

    def longest_along(self, longest: Scalar) -> Scalar:
        """The longest step of u, limited so that no step goes round the axis [m]."""
        return jnp.minimum(longest, WIDEST * self.radius)

    def normal(self, u: Scalar, f: Scalar, slope_u: Scalar, slope_v: Scalar) -> Vec3:
        """Unit outward normal, chart frame."""
        angle = u / self.radius
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        around = slope_u * self.radius / f  # slope along the arc itself
        k = 1 / jnp.sqrt(1 + around * around + slope_v * slope_v)
        return Vec3(k * (sine - around * cosine), -k * slope_v, k * (cosine + around * sine))

    def half_square(self, c: Vec3, u: Scalar) -> Callable[[Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]:
        """phi and its derivative along u, as a function of (v, height, slope along u) at one u."""
        angle = u / self.radius
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        along, across = sine * c.x + cosine * c.z, (cosine * c.x - sine * c.z) / self.radius

        def at(v: Scalar, r: Scalar, slope: Scalar) -> tuple[Scalar, Scalar]:
            gap, dv = r - along, v - c.y
            return 0.5 * (gap * gap + dv * dv), slope * gap - r * across

        return at

    def separation(self, c: Vec3, u: Scalar, v: Scalar, jet: Jet) -> Separation:
        """Derivatives of phi = |S(u, v) - c|^2 / 2 for a point c of the chart's frame."""
        angle, r, curl = u / self.radius, jet.f, 1 / self.radius
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        along = sine * c.x + cosine * c.z  # c's radial and tangential coordinates at this angle
        across = cosine * c.x - sine * c.z
        gap, turn = r - along, r * curl
        zero, one = jnp.zeros_like(r), jnp.ones_like(r)
        tangent_u = Vec3(jet.u * sine + turn * cosine, zero, jet.u * cosine - turn * sine)
        tangent_v = Vec3(jet.v * sine, one, jet.v * cosine)
        gram = jet.u * jet.u + turn * turn, jet.u * jet.v, 1 + jet.v * jet.v
        return Separation(
            (jet.u * gap - turn * across, jet.v * gap + (v - c.y)),
            (
                jet.u * jet.u + jet.uu * gap - 2 * jet.u * curl * across + turn * curl * along,
                gram[1] + jet.uv * gap - jet.v * curl * across,
                gram[2] + jet.vv * gap,
            ),
            gram,
            (tangent_u, tangent_v),
        )


Chart = PlaneChart | CylindricalChart
