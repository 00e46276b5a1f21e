"""Closest points between a point and a surface given over a chart: one safeguarded Newton step at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.patch.charts import Chart, Jet

Pair = tuple[Scalar, Scalar]
Triple = tuple[Scalar, Scalar, Scalar]
SHORT = 0.5  # share of the longest step below which a point counts as converged


# A surface along v at one u, for v on its domain: height and slope along u; and second derivative along u.
SurfaceProfile = tuple[Callable[[Scalar], tuple[Scalar, Scalar]], Callable[[Scalar], Scalar]]


class Surface(Protocol):
    """A height with two derivatives over a chart: a polynomial patch, a spline, a smooth implant."""

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

    def profile(self, u: Scalar) -> SurfaceProfile:
        """The surface along v at one u."""
        ...

    def unstacked(self) -> Surface:
        """The same surface, ready for a loop."""
        ...


class ClosestPoint(NamedTuple):
    """The result of a Newton step on the distance, and the surface's geometry there (chart frame)."""

    u: Scalar
    v: Scalar
    distance: Scalar  # from the surface to the point along the outward normal, negative inside the bone [m]
    normal: Vec3  # outward unit normal of the surface
    step: Scalar  # length of the step taken in (u, v): the start's distance from convergence [m]
    settled: Scalar  # 1 if the step was short, from the basin of a minimum (positive definite Hessian), else 0
    drift_u: Vec3  # the closest point's velocity is (drift_u . dc/dt, drift_v . dc/dt)
    drift_v: Vec3


def newton_step(surface: Surface, c: Vec3, u: Scalar, v: Scalar, longest: Scalar, push: float = 1.0) -> ClosestPoint:
    """One Newton step on |S(u, v) - c|^2 / 2 from (u, v), at most `longest` in either coordinate, nor round an axis.

    A start that is carried along with c's motion is off by so little that one step finds the closest point. Where the
    distance is nearly flat (a groove as round as the sphere) curvatures are held above a floor, so that the point does
    not leap. The floor is low: a point held back turns its force late, which drives a patella to sway. Where the
    Hessian is not positive definite (a saddle between two facets, say) the step goes downhill with the curvatures'
    absolute values and a small push across the groove, towards the sign of `push`, so that no start is held by a
    saddle. The distance returned is that of the surface point reached, never an extrapolation: a point that is still on
    its way understates an indentation and cannot invent one. The normal there is that of the surface's second-order
    expansion about the start, off by the step squared.

    Derivatives are those of the whole step and of the drift, by which the point is carried to the next one: where the
    distance is nearly flat and the step long, each part counts.
    """
    jet = surface.jet(u, v)
    s = surface.chart.separation(c, u, v, jet)
    tu, tv = s.tangents
    along = surface.chart.longest_along(longest)
    step = descend(s.gradient, s.hessian, (s.gram[0], s.gram[2]), (along, longest), push)
    du, dv = step.du, step.dv
    length = stop_gradient(jnp.maximum(jnp.abs(du), jnp.abs(dv)))
    slope_u, slope_v = jet.slopes_beside(du, dv)
    height = surface.height(u + du, v + dv)
    normal = surface.chart.normal(u + du, height, slope_u, slope_v)
    away = c - surface.chart.local_point(u + du, v + dv, height)
    distance = away.norm()
    drift_v = (tv - step.ratio * tu) * step.over_v
    return ClosestPoint(
        u + du,
        v + dv,
        jnp.where(away.dot(normal) < 0, -distance, distance),
        normal,
        length,
        jnp.where((step.convex > 0) & (jnp.abs(du) < SHORT * along) & (jnp.abs(dv) < SHORT * longest), 1.0, 0.0),
        tu * step.over_u - step.ratio * drift_v,
        drift_v,
    )


PUSH = 0.04  # of the longest step: what moves a point off a saddle
FLATTEST = 0.01  # curvatures of the distance below this share of the tangents' own are raised to it


class DescentStep(NamedTuple):
    """A step, and the solution of its equations."""

    du: Scalar
    dv: Scalar
    over_u: Scalar  # inverse pivots
    over_v: Scalar
    ratio: Scalar  # of the first equation that the second takes
    convex: Scalar  # 1 where the Hessian is positive definite, else 0; a number, since its derivative is not needed


def _limited(x: Scalar, most: Scalar) -> Scalar:
    """x held within +-most."""
    return jnp.where(x > most, most, jnp.where(x < -most, -most, x))


def descend(gradient: Pair, hessian: Triple, gram: Pair, longest: Pair, side: float) -> DescentStep:
    """The step from a point of the surface.

    Where the Hessian is positive definite it is Newton's, with pivots raised to `FLATTEST`; elsewhere curvatures are
    taken by their size, each coordinate for itself, with a small push along v to that side.

    Args:
        gradient, hessian: of the distance; by u and v, and by uu, uv and vv.
        gram: squares of the tangents along u and v.
        longest: step along u and v.
        side: +1 or -1.
    """
    (gu, gv), (huu, huv, hvv), (along, across) = gradient, hessian, longest
    convex = (huu > 0) & (huu * hvv > huv * huv)
    # Raising the second pivot alone keeps a flat valley's direction.
    over_u = 1 / jnp.maximum(jnp.where(convex, huu, jnp.abs(huu)), FLATTEST * gram[0])
    ratio = jnp.where(convex, huv, 0.0) * over_u
    over_v = 1 / jnp.maximum(jnp.where(convex, hvv - ratio * huv, jnp.abs(hvv)), FLATTEST * gram[1])
    dv = _limited((ratio * gu - gv) * over_v + jnp.where(convex, 0.0, side * PUSH * across), across)
    du = _limited(-gu * over_u - ratio * dv, along)
    return DescentStep(du, dv, over_u, over_v, ratio, jnp.where(convex, 1.0, 0.0))
