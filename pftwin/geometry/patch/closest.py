"""The point of a surface over a chart that is closest to a given point, tracked by safeguarded Newton steps."""

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


# A surface at one u, as functions of v on its domain: height and slope along u; and second derivative along u.
SurfaceProfile = tuple[Callable[[Scalar], tuple[Scalar, Scalar]], Callable[[Scalar], Scalar]]


class Surface(Protocol):
    """A height over a chart with two derivatives: a polynomial patch, a spline, or a smooth implant."""

    @property
    def chart(self) -> Chart:
        """The chart that maps (u, v, height) to points."""
        ...

    @property
    def center(self) -> Pair:
        """Centre (u, v) of its domain, a rectangle [m]."""
        ...

    @property
    def half_size(self) -> Pair:
        """Half the extent of its domain along u and v [m]."""
        ...

    def height(self, u: Scalar, v: Scalar) -> Scalar:
        """Height [m]."""
        ...

    def jet(self, u: Scalar, v: Scalar) -> Jet:
        """Height with its gradient and Hessian."""
        ...

    def outside(self, u: Scalar, v: Scalar) -> Scalar:
        """Distance of a point beyond the surface's domain [m]; zero inside."""
        ...

    def clipped(self, v: Scalar) -> Scalar:
        """The coordinate v limited to the domain [m]."""
        ...

    def profile(self, u: Scalar) -> SurfaceProfile:
        """The surface along v at one u."""
        ...

    def unstacked(self) -> Surface:
        """The same surface, prepared for use in a loop."""
        ...


def rectangle_of(surface: Surface) -> list[tuple[float, float]]:
    """Minimum and maximum of u, and of v, of a surface's domain, such as the rectangle to which it was fitted [m]."""
    return [(float(c) - float(h), float(c) + float(h)) for c, h in zip(surface.center, surface.half_size, strict=True)]


class ClosestPoint(NamedTuple):
    """The result of a Newton step on the distance, and the surface's geometry there (chart frame)."""

    u: Scalar
    v: Scalar
    distance: Scalar  # from the surface to the point along the outward normal, negative inside the bone [m]
    normal: Vec3  # outward unit normal of the surface
    step: Scalar  # length of the step in (u, v): an estimate of the start's error [m]
    settled: Scalar  # 1 if converged: a short step at a positive definite Hessian; else 0
    drift_u: Vec3  # the closest point's velocity is (drift_u . dc/dt, drift_v . dc/dt)
    drift_v: Vec3


def newton_step(surface: Surface, c: Vec3, u: Scalar, v: Scalar, longest: Scalar, side: float = 1.0) -> ClosestPoint:
    """One Newton step on |S(u, v) - c|^2 / 2 from (u, v), limited to `longest` per coordinate (and not round an axis).

    If the start is moved along with c, its error is so small that one step finds the closest point. Where the distance
    is nearly flat (a groove as round as the sphere) curvatures are limited from below, so that the point does not jump.
    The limit is low, since a delayed point delays the force's direction and makes a patella oscillate. Where the
    Hessian is not positive definite (for instance at a saddle between two facets) the step descends with the absolute
    values of the curvatures and a small push across the groove, in the direction of the sign of `side`, so that no
    start stays on a saddle. The returned distance is that of the surface point reached, not an extrapolation: a point
    that has not converged understates an indentation and never creates one. The normal there is that of the surface's
    second-order expansion about the start, with an error of second order in the step.

    Derivatives include those of the whole step and of the drift that moves the point to the next step: both matter
    where the distance is nearly flat and the step long.
    """
    jet = surface.jet(u, v)
    s = surface.chart.separation(c, u, v, jet)
    tu, tv = s.tangents
    along = surface.chart.longest_along(longest)
    step = descend(s.gradient, s.hessian, (s.gram[0], s.gram[2]), (along, longest), side)
    du, dv = step.du, step.dv
    length = stop_gradient(jnp.maximum(jnp.abs(du), jnp.abs(dv)))
    slope_u, slope_v = jet.slopes_beside(du, dv)
    height = surface.height(u + du, v + dv)
    normal = surface.chart.normal(u + du, height, slope_u, slope_v)
    away = c - surface.chart.local_point(u + du, v + dv, height)
    distance = away.norm()
    drift_v = (tv - step.ratio * tu) * step.over_v
    settled = (step.convex > 0) & (jnp.abs(du) < SHORT * along) & (jnp.abs(dv) < SHORT * longest)
    return ClosestPoint(
        u + du,
        v + dv,
        jnp.where(settled & (away.dot(normal) < 0), -distance, distance),
        normal,
        length,
        jnp.where(settled, 1.0, 0.0),
        tu * step.over_u - step.ratio * drift_v,
        drift_v,
    )


PUSH = 0.04  # step that moves a point off a saddle, as a share of the longest step
FLATTEST = 0.01  # lower limit of the curvatures of phi, as a share of the tangents' squares


class DescentStep(NamedTuple):
    """A step, and the factorization of its equations."""

    du: Scalar
    dv: Scalar
    over_u: Scalar  # inverse pivots
    over_v: Scalar
    ratio: Scalar  # multiple of the first equation that is subtracted from the second
    convex: Scalar  # 1 if the Hessian is positive definite, else 0; a float, since no derivative is needed


def _limited(x: Scalar, most: Scalar) -> Scalar:
    """x limited to +-most."""
    return jnp.where(x > most, most, jnp.where(x < -most, -most, x))


def descend(gradient: Pair, hessian: Triple, gram: Pair, longest: Pair, side: float) -> DescentStep:
    """The step from a point of the surface.

    If the Hessian is positive definite this is a Newton step with pivots of at least `FLATTEST`; else each coordinate
    descends separately with the absolute value of its curvature, and v gets a small push.

    Args:
        gradient, hessian: of phi; by u and v, and by uu, uv and vv.
        gram: squared lengths of the tangents along u and v.
        longest: longest step along u and v [m].
        side: +1 or -1, the direction of the push.
    """
    (gu, gv), (huu, huv, hvv), (along, across) = gradient, hessian, longest
    convex = (huu > 0) & (huu * hvv > huv * huv)
    # Raising only the second pivot keeps a flat valley's direction.
    over_u = 1 / jnp.maximum(jnp.where(convex, huu, jnp.abs(huu)), FLATTEST * gram[0])
    ratio = jnp.where(convex, huv, 0.0) * over_u
    over_v = 1 / jnp.maximum(jnp.where(convex, hvv - ratio * huv, jnp.abs(hvv)), FLATTEST * gram[1])
    dv = _limited((ratio * gu - gv) * over_v + jnp.where(convex, 0.0, side * PUSH * across), across)
    du = _limited(-gu * over_u - ratio * dv, along)
    return DescentStep(du, dv, over_u, over_v, ratio, jnp.where(convex, 1.0, 0.0))
