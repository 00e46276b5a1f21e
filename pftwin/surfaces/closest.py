"""Closest points between a point and a surface given over a chart: one safeguarded Newton step at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.spatial import Scalar, Vec3
from pftwin.surfaces.charts import Chart, Jet

PUSH = 0.04  # of the longest step: what moves a point off a saddle
FLATTEST = 0.1  # curvatures of the distance below this share of the tangents' own are raised to it
SHORT = 0.5  # of the longest step: up to here a point counts as having arrived


class Profile(NamedTuple):
    """A surface along v at one u: functions of v for v on the surface's domain."""

    height_and_slope: Callable[[Scalar], tuple[Scalar, Scalar]]  # the slope is that along u
    curvature: Callable[[Scalar], Scalar]  # second derivative along u


class Surface(Protocol):
    """Whatever gives a height with two derivatives over a chart: a polynomial patch, a spline, a smooth implant."""

    @property
    def chart(self) -> Chart:
        """How (u, v, height) make a point."""
        ...

    def height(self, u: Scalar, v: Scalar) -> Scalar:
        """Height alone."""
        ...

    def jet(self, u: Scalar, v: Scalar) -> Jet:
        """Height, gradient and Hessian."""
        ...

    def outside(self, u: Scalar, v: Scalar) -> Scalar:
        """How far beyond the surface's domain a point lies [m]; zero inside."""
        ...

    def clipped(self, v: Scalar) -> Scalar:
        """The nearest coordinate across the groove that lies on the domain."""
        ...

    def profile(self, u: Scalar) -> Profile:
        """The surface along v at one u."""
        ...

    def unstacked(self) -> Surface:
        """The same surface, ready for a loop."""
        ...


class ClosestPoint(NamedTuple):
    """Where a Newton step on the distance came out, and what the surface looks like there (chart frame)."""

    u: Scalar
    v: Scalar
    distance: Scalar  # from the surface to the point along the outward normal, negative inside the bone [m]
    normal: Vec3  # outward unit normal of the surface
    step: Scalar  # length of the step in (u, v) that was taken: how far from converged the start was [m]
    settled: (
        Scalar  # 1 if the step was short and its start in the basin of a minimum (positive definite Hessian), else 0
    )
    drift_u: Vec3  # the closest point's velocity is (drift_u . dc/dt, drift_v . dc/dt)
    drift_v: Vec3


def _limited(x: Scalar, most: Scalar) -> Scalar:
    """x held within +-most; unlike `clip`, with a derivative of a single operation."""
    return jnp.where(x > most, most, jnp.where(x < -most, -most, x))


def newton_step(surface: Surface, c: Vec3, u: Scalar, v: Scalar, longest: Scalar, push: float = 1.0) -> ClosestPoint:
    """One Newton step on |S(u, v) - c|^2 / 2 from (u, v), at most `longest` in either coordinate, nor round an axis.

    A start that is carried along with c's motion is off by so little that one step finds the closest point. Where the
    distance is nearly flat (a groove as round as the sphere) curvatures are held above a floor, so that the point
    crawls rather than leaps. Where the Hessian is not positive definite (a saddle between two facets, say) the step
    goes downhill with the curvatures' absolute values and a small push across the groove, towards the sign of `push`,
    so that no start is held by a saddle. The distance returned is that of the surface point reached, never an
    extrapolation: a point that is still on its way understates an indentation and cannot invent one. The normal there
    is that of the surface's second-order expansion about the start, off by the step squared.

    Derivatives are those of the step itself, the Hessian's and the start's included. Those of the closest point, by the
    implicit function theorem, are theirs to first order in the step's length; but a point that crawls along a groove
    as round as the sphere, or is on its way to a facet just found, follows the step and not the theorem.
    """
    jet = surface.jet(u, v)
    s = surface.chart.separation(c, u, v, jet)
    gu, gv = s.gradient
    (huu, huv, hvv), gram, (tu, tv) = s.hessian, s.gram, s.tangents
    convex = (huu > 0) & (huu * hvv > huv * huv)
    # Raising the second pivot alone keeps a flat valley's direction.
    over_u = 1 / jnp.maximum(jnp.where(convex, huu, jnp.abs(huu)), FLATTEST * gram[0])
    ratio = jnp.where(convex, huv, 0.0) * over_u
    over_v = 1 / jnp.maximum(jnp.where(convex, hvv - ratio * huv, jnp.abs(hvv)), FLATTEST * gram[2])
    dv = (ratio * gu - gv) * over_v + jnp.where(convex, 0.0, push * PUSH * longest)
    dv = _limited(dv, longest)
    along = surface.chart.longest_along(longest)
    du = _limited(-gu * over_u - ratio * dv, along)
    length = stop_gradient(jnp.maximum(jnp.abs(du), jnp.abs(dv)))
    _, slope_u, slope_v = jet.shifted(du, dv)
    height = surface.height(u + du, v + dv)
    normal = surface.chart.normal(u + du, height, slope_u, slope_v)
    away = c - surface.chart.local_point(u + du, v + dv, height)
    distance = away.norm()
    drift_v = (tv - ratio * tu) * over_v
    return ClosestPoint(
        u + du,
        v + dv,
        jnp.where(away.dot(normal) < 0, -distance, distance),
        normal,
        length,
        jnp.where(convex & (jnp.abs(du) < SHORT * along) & (jnp.abs(dv) < SHORT * longest), 1.0, 0.0),
        tu * over_u - ratio * drift_v,
        drift_v,
    )
