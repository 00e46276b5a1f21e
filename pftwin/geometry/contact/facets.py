"""Which facets of a groove a sphere touches: the local minima of its distance to the surface, medial and lateral.

A groove narrower than the button touches it on both facets, so the closest point is not one but two; a search from one
start finds one of them and rattles. Two points are followed, and each takes one Newton step per time step. Three rules
keep them right:

- They repel: off a saddle (a groove that has become too narrow for the sphere) the medial point is pushed medially, the
  lateral one laterally, so that each ends on its own facet. Where the distance has one minimum they meet in it.
- They are watched: the distance is sampled on a coarse fan across the groove. Where nobody is near the fan's first
  (medial) minimum the medial point starts again there, and likewise the lateral one near the last, so a facet that
  comes near is found before it touches. A point whose minimum has vanished goes where the other point is. Where the
  distance still falls at the fan's end, as on a wall steeper than the fan is wide, who has gone on beyond it is right.
- What both have in common counts once. Where the button is pressed in over the ridge between the two points as well,
  the contacts overlap, and what is stored is V(medial) + V(lateral) - V(ridge): all of both where the ridge is not
  touched, that of one where a point and the ridge meet and vanish. So no force jumps where facets part or merge. Forces
  are the slopes of that energy but for the ridge's own, which is taken off the two contacts along their normals.
"""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.geometry.patch.charts import Jet
from pftwin.geometry.patch.closest import ClosestPoint, Surface, newton_step

SPACING = 0.11  # of the fan's samples across the groove, in radii
FAN = tuple(SPACING * k for k in range(-6, 7))  # their places, in radii from the sphere's centre
LONGEST = 0.12  # radii: the longest Newton step
MERGED = 0.02  # separation, in radii, below which two points are one
REACH = 2.2  # spacings of the fan: how far from its middle a polynomial through five samples is believed
FLAT = 1e-10  # a ridge much lower than this is none [m]
SECTION = 33  # samples of a section across the surface
SHALLOW = 1e-4  # a groove less deep than this is none [m]
ASTRAY = 1.2  # distance from the fan's minimum, in spacings, beyond which a followed point starts again


class FollowedPoint(NamedTuple):
    """The last place of a followed point, moved along with the sphere since."""

    u: Scalar
    v: Scalar
    settled: Scalar  # 1 if it had arrived in a minimum, else 0; a number, which XLA fuses with its neighbours


class Ridge(NamedTuple):
    """Where the distance is largest between the medial and the lateral closest point, or the farther of these."""

    distance: Scalar  # from the sphere's centre; at least that of either point [m]
    place: Scalar  # 0 at the medial point to 1 at the lateral one


class Facets(NamedTuple):
    """The medial and the lateral closest point, the same where there is but one, and what is between them."""

    medial: ClosestPoint
    lateral: ClosestPoint
    ridge: Ridge


def follow_facets(surface: Surface, c: Vec3, radius: Scalar, places: tuple[FollowedPoint, FollowedPoint]) -> Facets:
    """One Newton step for both points, after they have been watched: who is astray starts elsewhere.

    Args:
        surface: with a chart whose v runs across the groove, medial to lateral.
        c: centre of the sphere, chart frame [m].
        radius: of the sphere [m].
        places: where the medial and the lateral point were, moved along with the sphere. Derivatives pass through them:
            a Newton step forgets its start to second order where it is whole, and not where it is held.
    """
    near = 0.5 * (places[0].u + places[1].u)
    # The fan decides, and no more: nothing is differentiated through it.
    seen, section = scan_facets(_without_derivatives(surface), *stop_gradient((c, radius, near)))
    _, middle = surface.chart.foot(c)
    ends = middle + FAN[0] * radius, middle + FAN[-1] * radius
    astray = ASTRAY * SPACING * radius
    in_order = places[0].v <= places[1].v
    starts = []
    for own, other, sample in zip(places, places[::-1], seen, strict=True):
        fan_v = surface.clipped(middle + sample * radius)
        at_end = [jnp.abs(fan_v - end) < 0.5 * SPACING * radius for end in ends]
        far, other_far = (_too_far(surface.clipped(p.v) - fan_v, at_end, astray) for p in (own, other))
        # Nobody follows the fan's minimum: start there. The other point does: a minimum of one's own, too shallow for
        # the fan to see, is kept; whoever has none joins the other point, whose place is better than the fan's.
        new, joins = far & other_far, far & ~other_far & ~((own.settled > 0) & in_order)
        u = jnp.where(new, near, jnp.where(joins, other.u, own.u))
        v = jnp.where(new, fan_v, jnp.where(joins, other.v, own.v))
        starts.append(FollowedPoint(u, v, own.settled))
    # A minimum that has just parted from the one that both follow is too near for the fan to see.
    spacing = SPACING * radius
    apart = stop_gradient(_other_minimum(section, (0.5 * (starts[0].v + starts[1].v) - middle) / spacing))
    merged = jnp.abs(starts[1].v - starts[0].v) < MERGED * radius
    medial, lateral = (
        start._replace(v=jnp.where(merged & parted, start.v + spacing * apart, start.v))
        for start, parted in zip(starts, (apart < 0, apart > 0), strict=True)
    )
    return facets_from(surface, c, radius, (medial, lateral))


def facets_from(surface: Surface, c: Vec3, radius: Scalar, places: tuple[FollowedPoint, FollowedPoint]) -> Facets:
    """One Newton step for both points from where they are, whatever else is near; see `follow_facets`."""
    medial, lateral = (
        newton_step(surface, c, p.u, p.v, LONGEST * radius, push=side)
        for p, side in zip(places, (-1.0, 1.0), strict=True)
    )
    return Facets(medial, lateral, _ridge_between(surface, c, medial, lateral))


def _ridge_between(surface: Surface, c: Vec3, medial: ClosestPoint, lateral: ClosestPoint) -> Ridge:
    """The ridge of a polynomial of fourth degree, flat at both points, through the distance midway between them."""
    u, v = 0.5 * (medial.u + lateral.u), 0.5 * (medial.v + lateral.v)
    away = c - surface.chart.local_point(u, v, surface.height(u, v))
    middle = away.norm()
    middle = jnp.where(away.dot(medial.normal + lateral.normal) < 0, -middle, middle)
    rise = lateral.distance - medial.distance
    bump = middle - 0.5 * (medial.distance + lateral.distance)
    bump = jnp.where(bump > 0, bump, 0.0)
    place = 0.5 + (3 / 32) * rise / (bump + FLAT)
    place = jnp.where(place > 1, 1.0, jnp.where(place < 0, 0.0, place))
    top = medial.distance + (16 / 3) * bump * place**3 * (2 - place)
    return Ridge(jnp.maximum(jnp.maximum(top, medial.distance), lateral.distance), place)


def _too_far(beyond: Scalar, at_end: list[Scalar], limit: Scalar) -> Scalar:
    """Whether a point is too far from the fan's minimum; outside the fan there is nothing to be too far from."""
    return ((beyond < -limit) & ~at_end[0]) | ((beyond > limit) & ~at_end[1])


def _other_minimum(section: Section, here: Scalar) -> Scalar:
    """How far from a minimum `here` a polynomial of fourth degree has another one; 0 where it has none.

    Its slope is (x - here) times (x - ridge) times (x - other), up to a factor; places are counted in spacings.
    """
    opens = section.fourth > 0
    scale = 1 / jnp.where(opens, section.fourth, 1.0)
    middle = -0.5 * (3 * section.third * scale + here)  # of the ridge and the other minimum
    square = middle * middle - 6 * section.second * scale + 2 * middle * here
    half = safe_sqrt(jnp.where(square > 0, square, 0.0))
    other = middle + jnp.where(middle > here, half, -half)
    found = opens & (square > 0) & (jnp.abs(other) < REACH) & (jnp.abs(middle - here) > half)
    return jnp.where(found, other - here, 0.0)


def _without_derivatives(surface: Surface) -> Surface:
    return jax.tree.map(lambda a: stop_gradient(a) if eqx.is_inexact_array(a) else a, surface)


class Section(NamedTuple):
    """Derivatives of half the squared distance across the groove, at the fan's middle, by spacings of the fan [m^2]."""

    second: Scalar
    third: Scalar
    fourth: Scalar


def scan_facets(surface: Surface, c: Vec3, radius: Scalar, u: Scalar) -> tuple[tuple[Scalar, Scalar], Section]:
    """The fan's samples (of `FAN`) at its first and last local minimum of the distance, at one u near both.

    Along the groove the distance has one well-shaped minimum, which each sample takes at its own place by a Newton
    step of u. The fan stays on the surface's domain; contacts beyond it are reached from its edge.
    """
    _, middle = surface.chart.foot(c)
    (height_and_slope, curvature), half_square = surface.profile(u), surface.chart.half_square(c, u)
    height, slope = height_and_slope(middle)
    zero = jnp.zeros_like(height)
    s = surface.chart.separation(c, u, middle, Jet(height, slope, zero, curvature(middle), zero, zero))
    compliance = 0.5 / jnp.maximum(s.hessian[0], 0.2 * s.gram[0])  # along the groove much the same across the fan
    places = [surface.clipped(middle + k * radius) for k in FAN]
    phi = []
    for v in places:
        value, gradient = half_square(v, *height_and_slope(v))
        phi.append(value - compliance * gradient * gradient)
    first, last = jnp.full_like(c.x, FAN[-1]), jnp.full_like(c.x, FAN[0])
    # Samples that coincide at an edge neither rise nor fall.
    for k, (before, after) in enumerate(pairwise(phi)):
        last = jnp.where(after < before, FAN[k + 1], last)
    for k, (before, after) in reversed(list(enumerate(pairwise(phi)))):
        first = jnp.where(before < after, FAN[k], first)
    a, b, m, d, e = phi[len(FAN) // 2 - 2 : len(FAN) // 2 + 3]
    second, third = (16 * (b + d) - (a + e) - 30 * m) / 12, 0.5 * (e - a) - (d - b)
    return (first, last), Section(second, third, a + e - 4 * (b + d) + 6 * m)


def medial_of_groove(surface: Surface, p: ClosestPoint) -> Scalar:
    """Whether a contact lies on the medial side of the groove's bottom, in the section through it; bool.

    Away from the bottom its place tells, since beyond a ridge the surface leans the other way again. Next to the bottom
    the lean tells, which is exact where a sample is not; and everywhere on a surface without a groove.
    """
    (u, v, lean), surface = stop_gradient((p.u, p.v, p.normal.y)), _without_derivatives(surface)
    places = jnp.linspace(surface.clipped(-jnp.ones_like(v)), surface.clipped(jnp.ones_like(v)), SECTION)
    height, _ = surface.profile(u)[0](places)
    # Filled with water, the groove is where it would stand deepest: below the lower of the highest walls on both sides.
    # Number by number: XLA aborts the process on running maxima of arrays in a loop over several devices of a CPU, and
    # on a GPU it would compute all of them anew for each number of an array.
    heights = [height[i] for i in range(SECTION)]
    walls = accumulate(heights, jnp.maximum), list(accumulate(heights[::-1], jnp.maximum))[::-1]
    deepest, bottom = jnp.full_like(v, -jnp.inf), v
    for i, (medial, lateral) in enumerate(zip(*walls, strict=True)):
        depth = jnp.minimum(medial, lateral) - heights[i]
        bottom = jnp.where(depth >= deepest, places[i], bottom)
        deepest = jnp.maximum(depth, deepest)
    beyond = v - bottom
    by_lean = (jnp.abs(beyond) < places[1] - places[0]) | (deepest < SHALLOW)
    return jnp.where(by_lean, lean >= 0, beyond < 0)
