"""The button's sphere on a trochlear surface: every local contact, medial and lateral at once.

A groove narrower than the button touches it on both facets, so two closest points are followed from step to step. They
are memory: each step takes one Newton step from where it left them, moved along with the sphere. When the two meet they
are one contact; it is counted once, and the spare point is sent across the sphere's centre to look for another facet.
While it searches it carries no force. Between one contact and two the shares blend smoothly over the points'
separation, so the force is continuous where facets merge.

Source of the force: Michaud et al. 2024, section 2.4.2 (the normal to the surface carries it, no friction).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.effects.base import Effect, Instant, Load, Observable, StiffTerm, applied_at
from pftwin.effects.contact_law import ContactLaw
from pftwin.spatial import Scalar, Vec3
from pftwin.surfaces.closest import ClosestPoint, Surface, newton_step

MERGED = 0.02  # closer than this share of the radius, two points are one contact
APART = 0.20  # beyond this share they are two in full
SETTLED_STEP = 0.005  # a searching point whose Newton step is below this share of the radius has found its minimum
LONGEST_STEP = 0.25  # of the radius: trust region of a Newton step
SEARCH_ACROSS = 0.5  # of the radius: where the search for another facet starts
SEARCH_STEPS = 12  # Newton steps of a search from nothing


class FacetPoint(NamedTuple):
    """A followed closest point: where its next Newton step starts, and what its contact remembers."""

    u: Scalar
    v: Scalar
    approach_speed: Scalar | None  # at the moment contact began [m/s]; 0 while not in contact; None if the law forgets


class ContactMemory(NamedTuple):
    """Two followed points, medial and lateral in no fixed order; `second_settled` is 0 while the second searches."""

    first: FacetPoint
    second: FacetPoint
    second_settled: Scalar


class Touch(NamedTuple):
    """One contact, resolved: geometry, kinematics, its share, and its law's answer as a stiff term."""

    closest: ClosestPoint
    indentation: Scalar
    share: Scalar
    approach_speed: Scalar | None
    term: StiffTerm
    energy: Scalar


class SphereContact(Effect):
    """A sphere fixed in the patella against a surface fixed in the femur."""

    surface: Surface
    law: ContactLaw
    center: Vec3  # of the sphere, patella frame [m]
    radius: Scalar  # [m]
    name: str = eqx.field(static=True, kw_only=True, default="contact")
    observables = {
        "force": Observable("N", "total normal contact force, sum over the facets"),
        "force_medial": Observable("N", "normal force on the medial contact"),
        "force_lateral": Observable("N", "normal force on the lateral contact"),
        "force_x": Observable("N", "contact force on the patella, femur x"),
        "force_y": Observable("N", "contact force on the patella, femur y"),
        "force_z": Observable("N", "contact force on the patella, femur z"),
        "indentation_medial": Observable("m", "indentation at the medial contact"),
        "indentation_lateral": Observable("m", "indentation at the lateral contact"),
        "point_medial": Observable("m", "medial contact point, femur frame"),
        "point_lateral": Observable("m", "lateral contact point, femur frame"),
        "off_patch": Observable("m", "how far beyond the fitted patch a loaded contact lies"),
    }

    def centre_in_chart(self, now: Instant) -> tuple[Vec3, Vec3]:
        """The sphere's centre and its velocity relative to the femur, in the chart's frame."""
        patella, femur = now.patella, now.femur
        centre = patella.position + patella.rotation.apply(self.center)
        velocity = femur.relative_velocity(patella.velocity_at(self.center), centre)
        chart = self.surface.chart
        return chart.to_frame(femur.to_local(centre)), chart.axes.unapply(femur.local_direction(velocity))

    def remember(self, now: Instant) -> ContactMemory:
        """Both facets, searched for from nothing."""
        c, _ = self.centre_in_chart(now)
        (u1, v1), (u2, v2), settled = self.search(c)
        speed = jnp.zeros_like(u1) if self.law.remembers_approach else None
        return ContactMemory(FacetPoint(u1, v1, speed), FacetPoint(u2, v2, speed), settled)

    def search(self, c: Vec3) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar], Scalar]:
        """The two local minima of the distance to c, from starts either side of it; and whether they are two."""
        u0, v0 = self.surface.chart.foot(c)
        across = SEARCH_ACROSS * self.radius

        def improve(points: Any, _: None) -> tuple[Any, None]:
            found = [newton_step(self.surface, c, u, v, LONGEST_STEP * self.radius) for u, v in points]
            return tuple((p.u, p.v) for p in found), found[1].step

        starts = jax.tree.map(jnp.asarray, ((u0, v0 - across), (u0, v0 + across)))
        (one, two), steps = jax.lax.scan(improve, starts, None, length=SEARCH_STEPS)
        apart = _apart(one, two) > MERGED * self.radius
        settled = apart & (steps[-1] < SETTLED_STEP * self.radius)
        return one, two, settled.astype(u0.dtype)

    def touches(self, now: Instant, memory: ContactMemory) -> tuple[Touch, Touch, ContactMemory]:
        """Both contacts at this instant, and the memory for the next."""
        c, velocity = self.centre_in_chart(now)
        memory = stop_gradient_of_points(memory)
        first, second = (
            newton_step(self.surface, c, p.u, p.v, LONGEST_STEP * self.radius) for p in (memory.first, memory.second)
        )
        apart = _apart((first.u, first.v), (second.u, second.v))
        merged = apart < MERGED * self.radius
        was_settled = memory.second_settled > 0
        found = was_settled | (second.convex & (second.step < SETTLED_STEP * self.radius))
        settled = found & ~merged
        blend = jnp.where(settled, _smoothstep(apart / self.radius, MERGED, APART), 0.0)
        share = jnp.where(settled, 0.5 + 0.5 * blend, 1.0), jnp.where(settled, 0.5 + 0.5 * blend, 0.0)
        one = self._touch(now, first, velocity, memory.first.approach_speed, share[0])
        two = self._touch(now, second, velocity, memory.second.approach_speed, share[1])
        return one, two, self._carry_on(now, c, velocity, one, two, merged, settled)

    def _touch(
        self, now: Instant, p: ClosestPoint, velocity: Vec3, approach_speed: Scalar | None, share: Scalar
    ) -> Touch:
        """The law at one closest point, felt already if the step about to be taken ends in contact."""
        indentation = self.radius - p.distance
        rate = -p.normal.dot(velocity)
        ahead = jnp.maximum(indentation, indentation + now.step * rate)
        if approach_speed is not None:
            begun = jnp.where(approach_speed > 0, approach_speed, jnp.maximum(rate, 1e-12))
            approach_speed = jnp.where((ahead > 0) & (share > 0), begun, 0.0)
        here = self.law.force(indentation, rate, approach_speed)
        if isinstance(now.step, float) and now.step == 0:
            at, pull_in = here, 0.0
        else:
            # Touch inside the step: slopes at the predicted indentation, the force extrapolated back to its start.
            touching = (indentation <= 0) & (ahead > 0)
            at = self.law.force(jnp.where(touching, ahead, indentation), rate, approach_speed)
            pull_in = jnp.where(touching, now.step * rate * at.stiffness, 0.0)
        world = now.femur.direction(self.surface.chart.axes.apply(p.normal))
        term = StiffTerm(
            world,
            applied_at(self.center, now.patella, world),
            share * (at.total - pull_in),
            share * here.elastic,
            share * at.stiffness,
            share * at.damping,
            rate,
        )
        return Touch(p, indentation, share, approach_speed, term, share * here.energy)

    def _carry_on(
        self, now: Instant, c: Vec3, velocity: Vec3, one: Touch, two: Touch, merged: Scalar, settled: Scalar
    ) -> ContactMemory:
        """Starts for the next step: moved along with the sphere; a spare point starts across the sphere's centre."""
        points = []
        for touch in (one, two):
            p = touch.closest
            du, dv = now.step * p.drift_u.dot(velocity), now.step * p.drift_v.dot(velocity)
            points.append((p.u + du, p.v + dv))
        (u1, v1), (u2, v2) = points
        u0, v0 = self.surface.chart.foot(c)
        across = jnp.maximum(jnp.abs(v1 - v0), SEARCH_ACROSS * self.radius)
        across = jnp.where(v1 > v0, v0 - across, v0 + across)
        u2, v2 = jnp.where(merged, u0, u2), jnp.where(merged, across, v2)
        return ContactMemory(
            FacetPoint(u1, v1, one.approach_speed),
            FacetPoint(u2, v2, two.approach_speed),
            settled.astype(u1.dtype),
        )

    def load(self, now: Instant, memory: ContactMemory) -> tuple[Load, ContactMemory]:
        """A stiff term per contact."""
        one, two, memory = self.touches(now, memory)
        return Load(stiff=(one.term, two.term), energy=one.energy + two.energy), memory

    def observe(self, now: Instant, memory: ContactMemory) -> dict[str, Any]:
        """Forces, points and indentations, told apart as medial and lateral."""
        one, two, _ = self.touches(now, memory)
        one_medial = (one.closest.v < two.closest.v) | (two.share == 0)
        single = two.share == 0
        c, _ = self.centre_in_chart(now)
        lateral_side = one.closest.v > self.surface.chart.foot(c)[1]
        one_is_medial = jnp.where(single, ~lateral_side, one_medial)
        force = one.term.force * one.term.direction + two.term.force * two.term.direction
        force = now.femur.local_direction(force)
        points = [self._point(t) for t in (one, two)]

        def facet(medial: bool, a: Any, b: Any) -> Any:
            return jax.tree.map(lambda x, y: jnp.where(one_is_medial == medial, x, y), a, b)

        forces = one.term.force, two.term.force
        depths = one.indentation, jnp.where(single, jnp.nan, two.indentation)
        loaded = [jnp.where(t.term.force > 0, self.surface.outside(t.closest.u, t.closest.v), 0.0) for t in (one, two)]
        return {
            "force": forces[0] + forces[1],
            "force_medial": facet(True, *forces),
            "force_lateral": facet(False, *forces),
            "force_x": force.x,
            "force_y": force.y,
            "force_z": force.z,
            "indentation_medial": facet(True, *depths),
            "indentation_lateral": facet(False, *depths),
            "point_medial": facet(True, *points).array(),
            "point_lateral": facet(False, *points).array(),
            "off_patch": jnp.maximum(loaded[0], loaded[1]),
        }

    def _point(self, touch: Touch) -> Vec3:
        """A contact point in the femur frame; NaN where there is none."""
        p, chart = touch.closest, self.surface.chart
        c = chart.local_point(p.u, p.v, self.surface.jet(p.u, p.v).f)
        touching = touch.term.force > 0
        return jax.tree.map(lambda x: jnp.where(touching, x, jnp.nan), chart.from_frame(c))

    def about(self, center_of_mass: Vec3) -> SphereContact:
        """Sphere centre counted from the centre of mass; the patch's coefficients one array each."""
        moved = eqx.tree_at(lambda e: e.center, self, self.center - center_of_mass)
        if hasattr(self.surface, "unstacked"):
            moved = eqx.tree_at(lambda e: e.surface, moved, self.surface.unstacked())
        return moved


def stop_gradient_of_points(memory: ContactMemory) -> ContactMemory:
    """A Newton step forgets its start to second order, so no derivative needs to pass through it."""
    first, second = (FacetPoint(*stop_gradient((p.u, p.v)), p.approach_speed) for p in memory[:2])
    return ContactMemory(first, second, stop_gradient(memory.second_settled))


def _apart(a: tuple[Scalar, Scalar], b: tuple[Scalar, Scalar]) -> Scalar:
    """The larger difference of coordinates: smooth enough, and cheaper than a distance."""
    return jnp.maximum(jnp.abs(a[0] - b[0]), jnp.abs(a[1] - b[1]))


def _smoothstep(x: Scalar, low: float, high: float) -> Scalar:
    """0 below `low`, 1 above `high`, a C1 cubic between."""
    t = jnp.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)
