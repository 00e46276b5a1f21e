"""Closest points between a point and a surface given over a chart: one safeguarded Newton step at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax.numpy as jnp

from pftwin.spatial import Scalar, Vec3
from pftwin.surfaces.charts import Chart, Jet

PUSH = 0.04  # of the longest step: what moves a point off a saddle
FLATTEST = 0.1  # curvatures of the distance below this share of the tangents' own are raised to it


class Surface(Protocol):
    """Whatever gives a height with two derivatives over a chart: a polynomial patch, a spline, a smooth implant."""

    @property
    def chart(self) -> Chart:
        """How (u, v, height) make a point."""
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

    def profile(self, u: Scalar) -> Callable[[Scalar], tuple[Scalar, Scalar]]:
        """Height and slope along u as a function of v, at one u."""
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
    convex: Scalar  # whether the start lay in the basin of a minimum (positive definite Hessian)
    drift_u: Vec3  # the closest point's velocity is (drift_u . dc/dt, drift_v . dc/dt)
    drift_v: Vec3


def newton_step(surface: Surface, c: Vec3, u: Scalar, v: Scalar, longest: Scalar, push: float = 1.0) -> ClosestPoint:
    """One Newton step on |S(u, v) - c|^2 / 2 from (u, v), at most `longest` in either coordinate.

    A start that is carried along with c's motion is off by so little that one step finds the closest point. Where the
    distance is nearly flat (a groove as round as the sphere) curvatures are held above a floor, so that the point
    crawls rather than leaps. Where the Hessian is not positive definite (a saddle between two facets, say) the step
    goes downhill with the curvatures' absolute values and a small push across the groove, towards the sign of `push`,
    so that no start is held by a saddle. The distance returned is that of the surface point reached, never an
    extrapolation: a point that is still on its way understates an indentation and cannot invent one.
    """
    jet = surface.jet(u, v)
    s = surface.chart.separation(c, u, v, jet)
    (gu, gv), (huu, huv, hvv), (tu, tv) = s.gradient, s.hessian, s.tangents
    least_u, least_v = FLATTEST * s.gram[0], FLATTEST * s.gram[2]
    convex = (huu > 0) & (huu * hvv > huv * huv)
    # Raising the second pivot alone keeps a flat valley's direction.
    auu = jnp.maximum(jnp.where(convex, huu, jnp.abs(huu)), least_u)
    auv = jnp.where(convex, huv, 0.0)
    ratio = auv / auu
    pivot = jnp.maximum(jnp.where(convex, hvv - ratio * huv, jnp.abs(hvv)), least_v)
    dv = -(gv - ratio * gu) / pivot
    dv = jnp.where(convex, dv, dv + push * PUSH * longest)
    dv = jnp.clip(dv, -longest, longest)
    du = jnp.clip(-gu / auu - ratio * dv, -longest, longest)
    reached = surface.jet(u + du, v + dv)
    point = surface.chart.local_point(u + du, v + dv, reached.f)
    normal = surface.chart.normal(u + du, reached.f, reached.u, reached.v)
    away = c - point
    height = away.dot(normal)
    drift_v = (tv - ratio * tu) * (1 / pivot)
    return ClosestPoint(
        u + du,
        v + dv,
        jnp.where(height < 0, -away.norm(), away.norm()),
        normal,
        jnp.maximum(jnp.abs(du), jnp.abs(dv)),
        convex,
        tu * (1 / auu) - ratio * drift_v,
        drift_v,
    )
