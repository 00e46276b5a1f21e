"""The button's sphere on a trochlear surface: every local contact, medial and lateral at once.

Source of the force: Michaud et al. 2024, section 2.4.2 (the normal to the surface carries it, no friction). How the
contacts are found: `pftwin.geometry.contact.facets`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.contact.facets import MERGED, FollowedPoint, follow_facets
from pftwin.geometry.patch.closest import ClosestPoint, Surface
from pftwin.model.effects.base import Instant, Load, Observable, StiffTerm, applied_at
from pftwin.model.effects.contact import FORCE, Contact
from pftwin.model.effects.contact_force import pushed
from pftwin.model.effects.contact_law import ContactLaw

if TYPE_CHECKING:
    from pftwin.model.effects.friction import Friction

SEARCH_STEPS = 10  # steps that find the contacts from nothing


class ContactMemory(NamedTuple):
    """What contact carries from step to step."""

    places: tuple[FollowedPoint, FollowedPoint]  # of the medial and the lateral point
    approach_speeds: tuple[Scalar, Scalar] | None  # at the moment each contact began, 0 while apart [m/s]


class Touch(NamedTuple):
    """One contact, resolved: geometry, kinematics, its share, and its law's answer as a stiff term."""

    closest: ClosestPoint
    indentation: Scalar
    share: Scalar
    approach_speed: Scalar | None
    term: StiffTerm
    energy: Scalar


class SphereContact(Contact):
    """A sphere fixed in the patella against a surface fixed in the femur."""

    surface: Surface
    law: ContactLaw
    center: Vec3 = eqx.field(metadata=quantity("m", frame="patella", words="centre of the button"))
    radius: Scalar = eqx.field(metadata=quantity("m", positive=True, words="radius of the button"))
    observables: ClassVar[dict[str, Observable]] = {
        **FORCE,
        "indentation_medial": Observable("m", "indentation at the medial contact"),
        "indentation_lateral": Observable("m", "indentation at the lateral contact"),
        "off_patch": Observable("m", "how far beyond the fitted patch a loaded contact lies"),
    }

    def centre_in_chart(self, now: Instant) -> tuple[Vec3, Vec3]:
        """The sphere's centre and its velocity relative to the femur, in the chart's frame."""
        patella, femur = now.patella, now.femur
        arm = patella.arm(self.center)
        centre = patella.position + arm
        velocity = femur.relative_velocity(patella.velocity_at(arm), centre)
        chart = self.surface.chart
        return chart.to_frame(femur.to_local(centre)), chart.axes.unapply(femur.local_direction(velocity))

    def guess(self, now: Instant) -> ContactMemory:
        """Both points below the sphere's centre, from where they find their way; no contact has begun yet."""
        c, _ = self.centre_in_chart(now)
        foot = FollowedPoint(*self.surface.chart.foot(c), jnp.zeros_like(c.x))
        zero = jnp.zeros_like(c.x)
        return ContactMemory((foot, foot), (zero, zero) if self.law.remembers_approach else None)

    def remember(self, now: Instant) -> ContactMemory:
        """Both points, found from nothing; no contact has begun yet."""
        c, _ = self.centre_in_chart(now)

        def improve(_: Scalar, places: tuple[FollowedPoint, FollowedPoint]) -> tuple[FollowedPoint, FollowedPoint]:
            found = follow_facets(self.surface, c, self.radius, places)
            medial, lateral = (FollowedPoint(p.u, p.v, p.settled) for p in (found.medial, found.lateral))
            return medial, lateral

        start = self.guess(now)
        return start._replace(places=jax.lax.fori_loop(0, SEARCH_STEPS, improve, start.places))

    def refined(self, memory: ContactMemory, trial: ContactMemory) -> ContactMemory:
        """The look's points."""
        return memory._replace(places=trial.places)

    def touches(self, now: Instant, memory: ContactMemory) -> tuple[Touch, Touch, ContactMemory]:
        """The medial and the lateral contact at this instant, and the memory for the next."""
        c, velocity = self.centre_in_chart(now)
        facets = follow_facets(self.surface, c, self.radius, memory.places)
        points = (facets.medial, facets.lateral)
        speeds = memory.approach_speeds or (None, None)
        one, two = (self._touch(now, p, velocity, speed, facets.share) for p, speed in zip(points, speeds, strict=True))
        way = now.step * velocity
        medial, lateral = (FollowedPoint(p.u + p.drift_u.dot(way), p.v + p.drift_v.dot(way), p.settled) for p in points)
        begun = None
        if one.approach_speed is not None and two.approach_speed is not None:
            begun = one.approach_speed, two.approach_speed
        return one, two, ContactMemory((medial, lateral), begun)

    def _touch(
        self, now: Instant, p: ClosestPoint, velocity: Vec3, approach_speed: Scalar | None, share: Scalar
    ) -> Touch:
        """The law at one closest point."""
        indentation = self.radius - p.distance
        world = now.femur.direction(self.surface.chart.axes.apply(p.normal))
        moment = applied_at(self.center, now.patella, world)
        rate = -p.normal.dot(velocity)
        push = pushed(self.law, now, indentation, rate, world, moment, approach_speed, share)
        return Touch(p, indentation, share, push.approach_speed, push.term, push.energy)

    def load(self, now: Instant, memory: ContactMemory) -> tuple[Load, ContactMemory]:
        """A stiff term per contact."""
        one, two, memory = self.touches(now, memory)
        return Load(stiff=(one.term, two.term), energy=one.energy + two.energy), memory

    def observe(self, now: Instant, memory: ContactMemory) -> dict[str, Any]:
        """Forces, points and indentations, told apart as medial and lateral."""
        one, two, _ = self.touches(now, memory)
        c, _ = self.centre_in_chart(now)
        # A single contact, of which both points bear half, belongs to the facet on its side of the sphere's centre.
        single = jnp.abs(one.closest.v - two.closest.v) < MERGED * self.radius
        on_medial = one.closest.v <= self.surface.chart.foot(c)[1]
        total = one.term.force + two.term.force
        force = now.femur.local_direction(one.term.force * one.term.direction + two.term.force * two.term.direction)
        report = {"force": total, "force_x": force.x, "force_y": force.y, "force_z": force.z}
        off_patch = jnp.zeros_like(total)
        for facet, touch, there in (("medial", one, on_medial), ("lateral", two, ~on_medial)):
            borne = jnp.where(single, jnp.where(there, total, 0.0), touch.term.force)
            p, loaded = touch.closest, borne > 0
            report[f"force_{facet}"] = borne
            report[f"indentation_{facet}"] = jnp.where(single & ~there, jnp.nan, touch.indentation)
            point = self.surface.chart.point(p.u, p.v, self.surface.jet(p.u, p.v).f).array()
            report[f"point_{facet}"] = jnp.where(loaded, point, jnp.nan)
            off_patch = jnp.maximum(off_patch, jnp.where(loaded, self.surface.outside(p.u, p.v), 0.0))
        return {**report, "off_patch": off_patch}

    def tracked_point(self) -> Vec3:
        """The sphere's centre."""
        return self.center

    def button_radius(self) -> Scalar:
        """The sphere's."""
        return self.radius

    def with_button_moved(self, by: Vec3) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda e: e.center, self, self.center + by)

    def groove_surface(self) -> Surface:
        """The surface itself."""
        return self.surface

    def fitted_surface(self) -> Surface:
        """The surface itself."""
        return self.surface

    def with_fitted_surface(self, surface: Surface) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda e: e.surface, self, surface)

    def with_friction(self, friction: Friction) -> Contact:
        """See `Contact`."""
        from pftwin.model.effects.rough_contact import RoughSphereContact

        return RoughSphereContact.of(self, friction)

    def recentred(self, center_of_mass: Vec3) -> SphereContact:
        """Sphere centre counted from the centre of mass; the patch's coefficients one array each."""
        moved = eqx.tree_at(lambda e: e.center, self, self.center - center_of_mass)
        return eqx.tree_at(lambda e: e.surface, moved, self.surface.unstacked())
