"""The button's sphere on a triangle mesh: the exact nearest point of every facet, medial and lateral at once.

The law is that of `SphereContact`; only the geometry differs. Nothing is followed from step to step: each step finds
its nearest points anew, by a tree (`pftwin.geometry.bvh`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.contact.facets import APART, MERGED
from pftwin.geometry.contact.mesh_facets import FacetPoint, MeshFacets
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import Instant, Load, Observable, applied_at
from pftwin.model.effects.contact import Contact
from pftwin.model.effects.contact_force import ContactPush, pushed
from pftwin.model.effects.contact_law import ContactLaw
from pftwin.model.effects.sphere_contact import SphereContact

if TYPE_CHECKING:
    from pftwin.model.effects.friction import Friction

_NAMES = {1: ("medial",), 2: ("medial", "lateral")}  # a mesh of one facet calls it medial

Memory = tuple[Scalar, ...] | None  # each facet's approach speed at the moment contact began, 0 while apart [m/s]


class MeshTouch(NamedTuple):
    """A sphere on one facet."""

    at: FacetPoint
    indentation: Scalar  # [m]
    share: Scalar  # of the law's force: 1, less where both facets' contacts are nearly one, 0 where it is none
    push: ContactPush


class MeshSphereContact(Contact):
    """A sphere fixed in the patella against a mesh fixed in the femur."""

    facets: MeshFacets
    law: ContactLaw
    center: Vec3 = eqx.field(metadata=quantity("m", frame="patella", words="centre of the button"))
    radius: Scalar = eqx.field(metadata=quantity("m", positive=True, words="radius of the button"))
    surface: Surface | None = None  # a smooth stand-in that tells where the groove is: for results alone
    method: ClassVar[str] = "nearest"
    observables: ClassVar[dict[str, Observable]] = {
        **SphereContact.observables,
        "off_patch": Observable("m", "how far sideways past the mesh's rim the sphere's centre lies, where loaded"),
        "overflow": Observable("1", "1 where the search ran out of room: the contact may be wrong"),
    }

    def remember(self, now: Instant) -> Memory:
        """No contact has begun yet."""
        zero = jnp.zeros_like(now.patella.position.x)
        return (zero,) * self.facets.count if self.law.remembers_approach else None

    def touches(self, now: Instant, memory: Memory) -> list[MeshTouch]:
        """The sphere on each facet."""
        arm = now.patella.arm(self.center)
        centre = now.patella.position + arm
        velocity = now.femur.local_direction(now.femur.relative_velocity(now.patella.velocity_at(arm), centre))
        points = self.facets.points(now.femur.to_local(centre))
        speeds = memory or (None,) * len(points)
        touches = []
        for p, share, speed in zip(points, _shares(points, self.radius), speeds, strict=True):
            world = now.femur.direction(p.normal)
            moment = applied_at(self.center, now.patella, world)
            indentation, rate = self.radius - p.distance, -p.normal.dot(velocity)
            push = pushed(self.law, now, indentation, rate, world, moment, speed, share)
            touches.append(MeshTouch(p, indentation, share, push))
        return touches

    def load(self, now: Instant, memory: Memory) -> tuple[Load, Memory]:
        """A stiff term for each facet."""
        touches = self.touches(now, memory)
        energy = sum((t.push.energy for t in touches[1:]), start=touches[0].push.energy)
        speeds = tuple(t.push.approach_speed for t in touches if t.push.approach_speed is not None)
        return Load(stiff=tuple(t.push.term for t in touches), energy=energy), speeds or None

    def observe(self, now: Instant, memory: Memory) -> dict[str, Any]:
        """Forces, points and indentations by facet; NaN for a facet whose contact is none of its own."""
        touches = self.touches(now, memory)
        zero = jnp.zeros_like(touches[0].indentation)
        nothing = jnp.full((3,), jnp.nan, zero.dtype)
        report: dict[str, Any] = {"force": zero, "off_patch": zero, "overflow": zero}
        total = Vec3(zero, zero, zero)
        for facet in _NAMES[2]:
            report |= {f"force_{facet}": zero, f"indentation_{facet}": zero * jnp.nan, f"point_{facet}": nothing}
        for facet, t in zip(_NAMES[len(touches)], touches, strict=True):
            force = t.push.term.force
            loaded = force > 0
            total = total + force * t.at.normal
            report["force"] = report["force"] + force
            report[f"force_{facet}"] = force
            report[f"indentation_{facet}"] = jnp.where(t.share > 0, t.indentation, jnp.nan)
            report[f"point_{facet}"] = jnp.where(loaded, t.at.point.array(), jnp.nan)
            report["off_patch"] = jnp.maximum(report["off_patch"], jnp.where(loaded, t.at.beyond_rim, 0.0))
            report["overflow"] = jnp.maximum(report["overflow"], t.at.overflow.astype(zero.dtype))
        return {**report, "force_x": total.x, "force_y": total.y, "force_z": total.z}

    def tracked_point(self) -> Vec3:
        """The sphere's centre."""
        return self.center

    def button_radius(self) -> Scalar:
        """The sphere's."""
        return self.radius

    def with_button_moved(self, by: Vec3) -> Self:
        """See `Contact`."""
        return eqx.tree_at(lambda e: e.center, self, self.center + by)

    def groove_surface(self) -> Surface | None:
        """The stand-in."""
        return self.surface

    def femur_triangles(self) -> Array:
        """See `Contact`."""
        return self.facets.triangles

    def with_friction(self, friction: Friction) -> Contact:
        """See `Contact`."""
        from pftwin.model.effects.rough_mesh_contact import RoughMeshSphereContact

        return RoughMeshSphereContact.of(self, friction)

    def recentred(self, center_of_mass: Vec3) -> MeshSphereContact:
        """Sphere centre counted from the centre of mass."""
        return eqx.tree_at(lambda e: e.center, self, self.center - center_of_mass)


def _shares(points: list[FacetPoint], radius: Scalar) -> list[Scalar]:
    """What part of the law's force each facet's contact bears.

    A nearest point on the seam, while the other facet is nearer, is no contact. Two that are both genuine bear all of
    the force where they are apart and half of it where they are one, as on a patch.
    """
    if len(points) == 1:
        return [jnp.ones_like(points[0].distance)]
    one, two = points
    gap = (one.point - two.point).norm()
    t = jnp.clip((gap / radius - MERGED) * (1 / (APART - MERGED)), 0.0, 1.0)
    share = 0.5 + 0.5 * t * t * (3 - 2 * t)
    no_one = one.on_seam & (two.distance < one.distance)
    no_two = two.on_seam & (one.distance <= two.distance)
    alone = no_one | no_two
    return [jnp.where(none, 0.0, jnp.where(alone, 1.0, share)) for none in (no_one, no_two)]
