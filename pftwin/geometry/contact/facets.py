"""The contacts of a sphere with the facets of a groove: the medial and lateral local minima of its distance.

A groove narrower than the button touches it on both facets, so there are two closest points; a search from a single
start would jump between them. Two points are tracked, each with one Newton step per time step, under three rules:

- Repulsion: off a saddle (a groove that has become too narrow for the sphere) the medial point is pushed medially and
  the lateral one laterally, so that each ends on its own facet. If the distance has one minimum both points meet there.
- Restarts: the distance is sampled on a coarse fan across the groove. If neither point is near the fan's first (medial)
  minimum, the medial point restarts there; the lateral point likewise at the last minimum. So an approaching facet is
  found before it touches. The fan may be wrong: it is coarse, and for a spline it samples a polynomial near it. So a
  converged point that touches leaves its minimum only towards its own side, and while the other point stays there. A
  point whose minimum has vanished moves to the other point. If the distance still falls at the fan's end, as on a wall
  steeper than the fan is wide, a point beyond the end is kept.
- Overlap counts once. If the button is also pressed in at the ridge between the two points, the contacts overlap, and
  the stored energy is V(medial) + V(lateral) - V(ridge): both in full where the ridge is not touched, that of one point
  where the other point and the ridge meet and vanish. So no force jumps where facets separate or merge. Forces are the
  gradient of that energy, except that the ridge's part is subtracted from the two contacts along their normals.
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
FAN = tuple(SPACING * k for k in range(-6, 7))  # positions of the samples, in radii from the sphere's centre
LONGEST = 0.12  # longest Newton step, in radii
NEAR = 0.03  # clearance, in radii, below which a converged point is kept against the fan
MERGED = 0.02  # separation, in radii, below which two points count as one
VALID_SPACINGS = 2.2  # validity of the polynomial through five samples, in spacings from the fan's middle
FLAT = 1e-10  # a much lower ridge does not count [m]
SECTION = 33  # samples of a section across the surface
SHALLOW = 1e-4  # a shallower groove does not count [m]
ASTRAY = 1.2  # distance from the fan's minimum, in spacings, beyond which a tracked point restarts


class FollowedPoint(NamedTuple):
    """Predicted chart coordinates [m] of a tracked point: its last ones, moved along with the sphere since."""

    u: Scalar
    v: Scalar
    settled: Scalar  # 1 if it had converged to a minimum, else 0; a float, which XLA fuses with its neighbours
    distance: Scalar  # of the sphere's centre from it at the last step [m]


def tracked_from(p: ClosestPoint, du: Scalar | float = 0.0, dv: Scalar | float = 0.0) -> FollowedPoint:
    """A closest point to start from at the next step, moved along with the sphere by (du, dv) [m]."""
    return FollowedPoint(p.u + du, p.v + dv, p.settled, stop_gradient(p.distance))


class Ridge(NamedTuple):
    """Maximum of the distance between the medial and the lateral closest point; or the farther of these."""

    distance: Scalar  # from the sphere's centre; at least that of either point [m]
    place: Scalar  # from 0 at the medial point to 1 at the lateral one


class Facets(NamedTuple):
    """The medial and the lateral closest point (equal if there is only one minimum), and the ridge between them."""

    medial: ClosestPoint
    lateral: ClosestPoint
    ridge: Ridge


def follow_facets(surface: Surface, c: Vec3, radius: Scalar, places: tuple[FollowedPoint, FollowedPoint]) -> Facets:
    """Restarts points that have lost their minimum, then takes one Newton step for both points.

    Args:
        surface: with a chart whose v runs across the groove, medial to lateral.
        c: centre of the sphere, chart frame [m].
        radius: of the sphere [m].
        places: predicted medial and lateral points. Derivatives pass through them: a full Newton step is independent of
            its start to second order, a limited step is not.
    """
    near = 0.5 * (places[0].u + places[1].u)
    # The fan only selects starts, so there are no derivatives through it.
    samples, section = scan_facets(_without_derivatives(surface), *stop_gradient((c, radius, near)))
    _, middle = surface.chart.foot(c)
    ends = middle + FAN[0] * radius, middle + FAN[-1] * radius
    astray = ASTRAY * SPACING * radius
    in_order = places[0].v <= places[1].v
    together = jnp.abs(places[1].v - places[0].v) < MERGED * radius
    starts = []
    # Whether a point is at a minimum that touches, or may in a moment, and stays there. One that does not touch would
    # keep both points from a new facet.
    needed = [(p.settled > 0) & (p.distance < (1 + NEAR) * radius) for p in places]
    for k, (own, other, sample) in enumerate(zip(places, places[::-1], samples, strict=True)):
        fan_v = surface.clipped(middle + sample * radius)
        at_end = [jnp.abs(fan_v - end) < 0.5 * SPACING * radius for end in ends]
        far, other_far = (_too_far(surface.clipped(p.v) - fan_v, at_end, astray) for p in (own, other))
        outward = fan_v < own.v if k == 0 else fan_v > own.v
        new = far & other_far & ~(needed[k] & ~(outward & together & needed[1 - k]))
        needed[k] &= ~new
        # If only the other point is near the fan's minimum, keep an own minimum that is needed, and may be too shallow
        # for the fan; else join the other point, which is more exact than the fan.
        joins = far & ~other_far & ~(needed[k] & (in_order | ~needed[1 - k]))
        u = jnp.where(new, near, jnp.where(joins, other.u, own.u))
        v = jnp.where(new, fan_v, jnp.where(joins, other.v, own.v))
        starts.append(FollowedPoint(u, v, own.settled, own.distance))
    # A minimum that has just split off from the common one is too near for the fan to resolve.
    spacing = SPACING * radius
    other_minimum = stop_gradient(_other_minimum(section, (0.5 * (starts[0].v + starts[1].v) - middle) / spacing))
    merged = jnp.abs(starts[1].v - starts[0].v) < MERGED * radius
    medial, lateral = (
        start._replace(v=jnp.where(merged & parted, start.v + spacing * other_minimum, start.v))
        for start, parted in zip(starts, (other_minimum < 0, other_minimum > 0), strict=True)
    )
    return facets_from(surface, c, radius, (medial, lateral))


def facets_from(surface: Surface, c: Vec3, radius: Scalar, places: tuple[FollowedPoint, FollowedPoint]) -> Facets:
    """One Newton step for both points without restarts; see `follow_facets`."""
    medial, lateral = (
        newton_step(surface, c, p.u, p.v, LONGEST * radius, side=side)
        for p, side in zip(places, (-1.0, 1.0), strict=True)
    )
    return Facets(medial, lateral, _ridge_between(surface, c, medial, lateral))


def _ridge_between(surface: Surface, c: Vec3, medial: ClosestPoint, lateral: ClosestPoint) -> Ridge:
    """Ridge of the quartic polynomial that is flat at both points and passes through the distance midway."""
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
    """Whether a point is too far from the fan's minimum; not beyond an end of the fan at which the minimum lies."""
    return ((beyond < -limit) & ~at_end[0]) | ((beyond > limit) & ~at_end[1])


def _other_minimum(section: GrooveSection, here: Scalar) -> Scalar:
    """Offset from a minimum `here` to the other minimum of a quartic polynomial; 0 if it has none; in spacings.

    Up to a factor its slope is (x - here) times (x - ridge) times (x - other).
    """
    opens = section.fourth > 0
    scale = 1 / jnp.where(opens, section.fourth, 1.0)
    middle = -0.5 * (3 * section.third * scale + here)  # midway between the ridge and the other minimum
    square = middle * middle - 6 * section.second * scale + 2 * middle * here
    half = safe_sqrt(jnp.where(square > 0, square, 0.0))
    other = middle + jnp.where(middle > here, half, -half)
    found = opens & (square > 0) & (jnp.abs(other) < VALID_SPACINGS) & (jnp.abs(middle - here) > half)
    return jnp.where(found, other - here, 0.0)


def _without_derivatives(surface: Surface) -> Surface:
    return jax.tree.map(lambda a: stop_gradient(a) if eqx.is_inexact_array(a) else a, surface)


class GrooveSection(NamedTuple):
    """Derivatives of half the squared distance across the groove, at the fan's middle, per spacing [m^2]."""

    second: Scalar
    third: Scalar
    fourth: Scalar


def scan_facets(surface: Surface, c: Vec3, radius: Scalar, u: Scalar) -> tuple[tuple[Scalar, Scalar], GrooveSection]:
    """Elements of `FAN` at the first and the last local minimum of the distance, at one u near both; and the section.

    Along the groove the distance has a single regular minimum, which each sample approaches by a Newton step of u. The
    fan is limited to the surface's domain; contacts beyond it are reached from its edge.
    """
    _, middle = surface.chart.foot(c)
    (height_and_slope, curvature), half_square = surface.profile(u), surface.chart.half_square(c, u)
    height, slope = height_and_slope(middle)
    zero = jnp.zeros_like(height)
    s = surface.chart.separation(c, u, middle, Jet(height, slope, zero, curvature(middle), zero, zero))
    compliance = 0.5 / jnp.maximum(s.hessian[0], 0.2 * s.gram[0])  # nearly constant across the fan
    places = [surface.clipped(middle + k * radius) for k in FAN]
    phi = []
    for v in places:
        value, gradient = half_square(v, *height_and_slope(v))
        phi.append(value - compliance * gradient * gradient)
    first, last = jnp.full_like(c.x, FAN[-1]), jnp.full_like(c.x, FAN[0])
    # Samples that coincide at an edge count neither as rising nor as falling.
    for k, (before, after) in enumerate(pairwise(phi)):
        last = jnp.where(after < before, FAN[k + 1], last)
    for k, (before, after) in reversed(list(enumerate(pairwise(phi)))):
        first = jnp.where(before < after, FAN[k], first)
    a, b, m, d, e = phi[len(FAN) // 2 - 2 : len(FAN) // 2 + 3]
    second, third = (16 * (b + d) - (a + e) - 30 * m) / 12, 0.5 * (e - a) - (d - b)
    return (first, last), GrooveSection(second, third, a + e - 4 * (b + d) + 6 * m)


def medial_of_groove(surface: Surface, p: ClosestPoint) -> Scalar:
    """Whether a contact lies medial of the groove's bottom, in the section through it; bool.

    Away from the bottom the position decides, since beyond a ridge the surface's inclination is reversed. Next to the
    bottom, and everywhere on a surface without a groove, the inclination decides, which is exact there.
    """
    (u, v, lean), surface = stop_gradient((p.u, p.v, p.normal.y)), _without_derivatives(surface)
    places = jnp.linspace(surface.clipped(-jnp.ones_like(v)), surface.clipped(jnp.ones_like(v)), SECTION)
    height, _ = surface.profile(u)[0](places)
    # The groove's bottom is where water would stand deepest: below the lower of the highest walls on both sides.
    # Scalars are used since XLA aborts on cumulative maxima of arrays in a loop over several devices of a CPU, and on a
    # GPU would recompute all of them for each element.
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
