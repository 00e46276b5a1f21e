"""Contact of a spherical button with a triangle mesh, at the exact nearest point of the medial and the lateral facet.

The force is that of `SphereContact`; only the geometry differs. No contact point is tracked between steps: each step
searches a bounding volume hierarchy (`pftwin.geometry.bvh`) for the nearest points.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.leaves import traced_once
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.contact.patch_mesh import FacetPoint, MeshFacets
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.contact import BY_FACET, ButtonSphere, Contact, Touch, facet_report, load_of, vector_sum
from pftwin.model.effects.contact_law import ContactLaw, Speeds
from pftwin.model.effects.friction import Friction, WithFriction

ONE, TWO = 0.02, 0.20  # distances of two nearest points, in radii: one contact below the first, two above the second


class MeshSphereContact(ButtonSphere):
    """A sphere fixed in the patella against a mesh fixed in the femur."""

    facets: MeshFacets
    law: ContactLaw
    center: Vec3 = eqx.field(metadata=quantity("m", frame="patella", words="centre of the button"))
    radius: Scalar = eqx.field(metadata=quantity("m", positive=True, words="radius of the button"))
    surface: Surface | None = None  # smooth substitute that defines the groove, used only for results
    method: ClassVar[str] = "nearest"
    in_turns: ClassVar[bool] = True
    observables: ClassVar[dict[str, Observable]] = {
        **BY_FACET,
        "off_patch": Observable("m", "how far sideways past the mesh's rim the sphere's centre lies, where loaded"),
        "overflow": Observable("1", "1 where the search ran out of room: the contact may be wrong"),
    }

    def remember(self, now: Instant) -> Speeds:
        """Initial memory: no contact has begun."""
        return self.law.no_contact_yet(now.patella.position.x, self.facets.count)

    @traced_once
    def touches(self, now: Instant, memory: Speeds) -> list[Touch[FacetPoint]]:
        """Contact of the sphere with each facet."""
        centre, velocity = self.centre_in_femur(now)
        points = self.facets.points(centre)
        speeds, shares = memory or (None,) * len(points), _load_shares(points, self.radius)
        return [
            self.touch(now, p, p.normal, -p.normal.dot(velocity), speed, share)
            for p, speed, share in zip(points, speeds, shares, strict=True)
        ]

    def load(self, now: Instant, memory: Speeds) -> tuple[Load, Speeds]:
        """See `Effect`: a stiff term per facet."""
        return load_of([t.normal_force for t in self.touches(now, memory)])

    def report(self, now: Instant, memory: Speeds) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`: forces, points and indentations per facet; NaN for a facet without a separate contact."""
        touches = self.touches(now, memory)
        forces = [t.normal_force.term.force for t in touches]
        total = vector_sum([f * t.at.normal for f, t in zip(forces, touches, strict=True)])
        indentations = [jnp.where(t.share > 0, t.indentation, jnp.nan) for t in touches]
        points = [jnp.where(f > 0, t.at.point.array(), jnp.nan) for f, t in zip(forces, touches, strict=True)]
        beyond = [jnp.where(f > 0, t.at.beyond_rim, 0.0) for f, t in zip(forces, touches, strict=True)]
        overflow = jnp.stack([t.at.overflow for t in touches]).any().astype(forces[0].dtype)
        shown = facet_report(total, forces, indentations, points)
        shown |= {"off_patch": jnp.maximum(jnp.stack(beyond).max(), 0.0), "overflow": overflow}
        return shown, load_of([t.normal_force for t in touches])[0].energy

    def femur_triangles(self) -> Array:
        """See `Contact`."""
        return self.facets.triangles

    def with_friction(self, friction: Friction) -> Contact:
        """See `Contact`."""
        return RoughMeshSphereContact.of(self, friction)


class RoughMeshSphereContact(WithFriction, MeshSphereContact):
    """`MeshSphereContact` with friction on every facet."""

    frictionless: ClassVar[type[Contact]] = MeshSphereContact
    observables: ClassVar[dict[str, Observable]] = {**MeshSphereContact.observables, **WithFriction.tangential}


def _load_shares(points: list[FacetPoint], radius: Scalar) -> list[Scalar]:
    """Fraction of the law's force that each facet's contact bears.

    A nearest point on the seam is no contact while the other facet is nearer. Two actual contacts bear the full force
    each where they are separate, and half of it each where they coincide, with a smooth transition in between.
    """
    if len(points) == 1:
        return [jnp.ones_like(points[0].distance)]
    one, two = points
    gap = (one.point - two.point).norm()
    t = jnp.clip((gap / radius - ONE) * (1 / (TWO - ONE)), 0.0, 1.0)
    share = 0.5 + 0.5 * t * t * (3 - 2 * t)
    no_one = one.on_seam & (two.distance < one.distance)
    no_two = two.on_seam & (one.distance <= two.distance)
    alone = no_one | no_two
    return [jnp.where(none, 0.0, jnp.where(alone, 1.0, share)) for none in (no_one, no_two)]
