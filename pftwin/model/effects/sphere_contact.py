"""Contact of a spherical button with a smooth trochlear surface, at the medial and the lateral contact point.

Source of the force: Michaud et al. 2024, section 2.4.2 (along the surface normal, without friction). The contact
search is in `pftwin.geometry.contact.facets`.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.leaves import traced_once
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.contact.facets import (
    MERGED,
    Facets,
    FollowedPoint,
    facets_from,
    follow_facets,
    medial_of_groove,
    tracked_from,
)
from pftwin.geometry.patch.closest import ClosestPoint, Surface
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.contact import BY_FACET, ButtonSphere, Contact, Touch, facet_report, load_of
from pftwin.model.effects.contact_law import ContactLaw, Speeds
from pftwin.model.effects.friction import Friction, WithFriction

SHALLOWEST = 1e-6  # smallest indentation used to decide how far two contacts overlap [m]
SEARCH_STEPS = 10  # iterations of the contact search without a previous guess


class ContactMemory(NamedTuple):
    """Memory of the contact from step to step."""

    places: tuple[FollowedPoint, FollowedPoint]  # medial and lateral contact point
    approach_speeds: Speeds


class SphereContact(ButtonSphere):
    """A sphere fixed in the patella against a surface fixed in the femur."""

    surface: Surface
    law: ContactLaw
    center: Vec3 = eqx.field(metadata=quantity("m", frame="patella", words="centre of the button"))
    radius: Scalar = eqx.field(metadata=quantity("m", positive=True, words="radius of the button"))
    observables: ClassVar[dict[str, Observable]] = {
        **BY_FACET,
        "off_patch": Observable("m", "how far beyond the fitted patch a loaded contact lies"),
        "overflow": Observable("1", "1 where the search has missed that the button's centre is inside the bone"),
    }

    def centre_in_chart(self, now: Instant) -> tuple[Vec3, Vec3]:
        """The sphere's centre [m] and its velocity relative to the femur [m/s], in the chart's frame."""
        centre, velocity = self.centre_in_femur(now)
        chart = self.surface.chart
        return chart.to_frame(centre), chart.axes.unapply(velocity)

    def guess(self, now: Instant) -> ContactMemory:
        """See `Effect`: both points start below the sphere's centre; no contact has begun."""
        c, _ = self.centre_in_chart(now)
        foot = FollowedPoint(*self.surface.chart.foot(c), jnp.zeros_like(c.x), jnp.zeros_like(c.x))
        return ContactMemory((foot, foot), self.law.no_contact_yet(now.patella.position.x, 2))

    def remember(self, now: Instant) -> ContactMemory:
        """See `Effect`: both points from a search without a previous guess; no contact has begun."""
        c, _ = self.centre_in_chart(now)

        def improve(_: Scalar, places: tuple[FollowedPoint, FollowedPoint]) -> tuple[FollowedPoint, FollowedPoint]:
            found = follow_facets(self.surface, c, self.radius, places)
            return tracked_from(found.medial), tracked_from(found.lateral)

        start = self.guess(now)
        return start._replace(places=jax.lax.fori_loop(0, SEARCH_STEPS, improve, start.places))

    def refined(self, memory: ContactMemory, trial: ContactMemory) -> ContactMemory:
        """See `Effect`: the memory with the trial's contact points."""
        return memory._replace(places=trial.places)

    @traced_once
    def touches(
        self, now: Instant, memory: ContactMemory
    ) -> tuple[Touch[ClosestPoint], Touch[ClosestPoint], ContactMemory]:
        """The medial and the lateral contact at an instant, and the memory for the next step."""
        c, _ = self.centre_in_chart(now)
        return self._touches_at(follow_facets(self.surface, c, self.radius, memory.places), now, memory)

    @traced_once
    def standing_touches(self, now: Instant, memory: ContactMemory) -> tuple[Touch[ClosestPoint], Touch[ClosestPoint]]:
        """The contacts of the step to this instant, without a new search, so that observing does not change them.

        The velocity at the end of a step is consistent with the contacts of that step. For any other contact, damping
        would turn it into hundreds of newtons, which never act on the motion because the next step adapts at once.
        """
        c, _ = self.centre_in_chart(now)
        return self._touches_at(facets_from(self.surface, c, self.radius, memory.places), now, memory)[:2]

    def _touches_at(
        self, facets: Facets, now: Instant, memory: ContactMemory
    ) -> tuple[Touch[ClosestPoint], Touch[ClosestPoint], ContactMemory]:
        _, velocity = self.centre_in_chart(now)
        speeds, way = memory.approach_speeds or (None, None), now.step * velocity
        touches, places = [], []
        ridge = facets.ridge
        near = 1 - ridge.place, ridge.place  # fraction of the ridge's force to subtract from each contact's
        for p, speed, less in zip((facets.medial, facets.lateral), speeds, near, strict=True):
            normal = self.surface.chart.axes.apply(p.normal)
            depth = jnp.maximum(self.radius - p.distance, SHALLOWEST)
            on_ridge = 1 - (ridge.distance - p.distance) / depth  # ratio of indentations: at the ridge to this contact
            overlap = less * self.law.elastic_ratio(on_ridge)
            bears, stores = 1 - overlap, 1 - overlap * on_ridge
            touches.append(self.touch(now, p, normal, -p.normal.dot(velocity), speed, bears, stores))
            places.append(tracked_from(p, p.drift_u.dot(way), p.drift_v.dot(way)))
        (one, two), (medial, lateral) = touches, places
        return one, two, ContactMemory((medial, lateral), load_of([one.normal_force, two.normal_force])[1])

    def load(self, now: Instant, memory: ContactMemory) -> tuple[Load, ContactMemory]:
        """See `Effect`: a stiff term per contact."""
        one, two, memory = self.touches(now, memory)
        return load_of([one.normal_force, two.normal_force])[0], memory

    def standing_load(self, now: Instant, memory: ContactMemory) -> Load:
        """See `Contact`: a stiff term for each of `standing_touches`."""
        return load_of([t.normal_force for t in self.standing_touches(now, memory)])[0]

    def report(self, now: Instant, memory: ContactMemory) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`: forces, points and indentations per facet, medial and lateral."""
        touches = self.standing_touches(now, memory)
        ends = [t.normal_force.term for t in touches]
        vector = ends[0].force * ends[0].direction + ends[1].force * ends[1].direction
        one, two = (t.at for t in touches)
        # Where both points are one contact and bear half of its force each, they belong to one facet.
        first = medial_of_groove(self.surface, one)
        second = jnp.where(jnp.abs(one.v - two.v) < MERGED * self.radius, first, medial_of_groove(self.surface, two))
        places, off_patch = [], jnp.zeros_like(one.u)
        for p, term in zip((one, two), ends, strict=True):
            places.append(self.surface.chart.point(p.u, p.v, self.surface.jet(p.u, p.v).f).array())
            off_patch = jnp.maximum(off_patch, jnp.where(term.force > 0, self.surface.outside(p.u, p.v), 0.0))
        forces, indentations, points = [], [], []
        for here in ((first, second), (~first, ~second)):
            borne = [jnp.where(on, term.force, 0.0) for on, term in zip(here, ends, strict=True)]
            depths = [jnp.where(on, t.indentation, -jnp.inf) for on, t in zip(here, touches, strict=True)]
            forces.append(borne[0] + borne[1])
            indentations.append(jnp.where(here[0] | here[1], jnp.maximum(*depths), jnp.nan))
            more = jnp.where(borne[0] >= borne[1], places[0], places[1])
            points.append(jnp.where(forces[-1] > 0, more, jnp.nan))
        shown = {
            **facet_report(now.femur.local_direction(vector), forces, indentations, points),
            "off_patch": off_patch,
            "overflow": self._missed(now, one, two),
        }
        return shown, load_of([t.normal_force for t in touches])[0].energy

    def _missed(self, now: Instant, one: ClosestPoint, two: ClosestPoint) -> Scalar:
        """1 where the sphere's centre lies below the surface and neither point says so, else 0.

        A point that has not converged counts as outside the bone, and one may have converged elsewhere.
        """
        centre = self.surface.chart.coordinates(self.centre_in_femur(now)[0])
        inside = centre.z < self.surface.jet(centre.x, centre.y).f
        return jnp.where(inside & (one.distance > 0) & (two.distance > 0), 1.0, 0.0)

    def fitted_surface(self) -> Surface:
        """The field `surface`."""
        return self.surface

    def with_fitted_surface(self, surface: Surface) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda e: e.surface, self, surface)

    def with_friction(self, friction: Friction) -> Contact:
        """See `Contact`."""
        return RoughSphereContact.of(self, friction)

    def recentred(self, center_of_mass: Vec3) -> Self:
        """See `Effect`; also splits the patch's coefficients into one array each."""
        return eqx.tree_at(lambda e: e.surface, super().recentred(center_of_mass), self.surface.unstacked())


class RoughSphereContact(WithFriction, SphereContact):
    """`SphereContact` with friction at the medial and at the lateral contact."""

    frictionless: ClassVar[type[Contact]] = SphereContact
    observables: ClassVar[dict[str, Observable]] = {**SphereContact.observables, **WithFriction.tangential}
