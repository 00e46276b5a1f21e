"""Which facets of a groove a sphere touches: the local minima of its distance to the surface, medial and lateral.

A groove narrower than the button touches it on both facets, so the closest point is not one but two; a search from one
start finds one of them and rattles. Two points are followed, and each takes one Newton step per time step. Three rules
keep them right:

- They repel: off a saddle (a groove that has become too narrow for the sphere) the medial point is pushed medially, the
  lateral one laterally, so that each ends on its own facet. Where the distance has one minimum they meet in it.
- They are watched: the distance is sampled on a coarse fan across the groove, and a point that is far from the fan's
  first (medial) or last (lateral) minimum starts again there. A facet that comes near is found before it touches.
- They share: each bears half of the contact law's force where they are one and all of it where they are two, smoothly
  in between, so the force has no jump where facets merge and nothing is counted twice.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.spatial import Scalar, Vec3
from pftwin.surfaces.closest import ClosestPoint, Surface, newton_step

SPACING = 0.11  # of the fan's samples across the groove, in radii
FAN = tuple(SPACING * k for k in range(-6, 7))  # their places, in radii from the sphere's centre
LONGEST = 0.12  # radii: the longest Newton step
MERGED, APART = 0.02, 0.20  # separations, in radii, between which one contact becomes two
ASTRAY = 1.2  # spacings from the fan's minimum beyond which a followed point starts again

Place = tuple[Scalar, Scalar]  # (u, v)


class Facets(NamedTuple):
    """The medial and the lateral closest point (the same where there is but one) and the share that each bears."""

    medial: ClosestPoint
    lateral: ClosestPoint
    share: Scalar  # of the contact law's force, for each: 1/2 where they are one, 1 where they are two


def follow_facets(surface: Surface, c: Vec3, radius: Scalar, places: tuple[Place, Place]) -> Facets:
    """One Newton step for both points from the places where they were left.

    Args:
        surface: with a chart whose v runs across the groove, medial to lateral.
        c: centre of the sphere, chart frame [m].
        radius: of the sphere [m].
        places: where the medial and the lateral point were, moved along with the sphere.
    """
    near = 0.5 * (places[0][0] + places[1][0])
    seen = scan_facets(surface, c, radius, near)
    astray = ASTRAY * SPACING * radius
    points = []
    for (u, v), (fan_u, fan_v), side in zip(places, seen, (-1.0, 1.0), strict=True):
        lost = jnp.abs(surface.clipped(v) - fan_v) > astray
        start = jnp.where(lost, fan_u, u), jnp.where(lost, fan_v, v)
        points.append(newton_step(surface, c, *start, LONGEST * radius, push=side))
    medial, lateral = points
    t = jnp.clip((jnp.abs(lateral.v - medial.v) / radius - MERGED) / (APART - MERGED), 0.0, 1.0)
    return Facets(medial, lateral, 0.5 + 0.5 * t * t * (3 - 2 * t))


def scan_facets(surface: Surface, c: Vec3, radius: Scalar, u: Scalar) -> tuple[Place, Place]:
    """Places near the first and the last local minimum of the fan, refined by the parabola through three samples.

    Along the groove the distance has one well-shaped minimum, so a u near it suffices. The fan stays on the surface's
    domain; contacts beyond it are reached from its edge.
    """
    spacing = SPACING * radius
    _, middle = surface.chart.foot(c)
    across, along = surface.profile(u), surface.chart.half_square(c, u)
    jet = surface.jet(u, middle)
    s = surface.chart.separation(c, u, middle, jet)
    compliance = 1 / jnp.maximum(s.hessian[0], 0.2 * s.gram[0])  # along the groove much the same across the fan
    phi, places = [], []
    for k in FAN:
        v = surface.clipped(middle + k * radius)
        value, slope = along(v, *across(v))
        shift = -compliance * slope
        phi.append(value + 0.5 * shift * slope)
        places.append((u + shift, v))
    last = len(FAN) - 1
    found: list[tuple[Scalar, Place]] = []
    for k, (at_u, at_v) in enumerate(places):
        left, right = phi[max(k - 1, 0)], phi[min(k + 1, last)]
        if k in (0, last):
            lowest = phi[k] < (right if k == 0 else left)
        else:
            lowest = (phi[k] < left) & (phi[k] <= right)
            bend = jnp.maximum(left - 2 * phi[k] + right, 1e-30)
            at_v = at_v + spacing * jnp.clip(0.5 * (left - right) / bend, -0.5, 0.5)
        found.append((lowest, (at_u, at_v)))
    return _first(found), _first(found[::-1])


def _first(found: list[tuple[Scalar, Place]]) -> Place:
    """The first place of a list at which the condition holds; there is always one."""
    u, v = found[-1][1]
    for condition, (a, b) in reversed(found[:-1]):
        u, v = jnp.where(condition, a, u), jnp.where(condition, b, v)
    return u, v
