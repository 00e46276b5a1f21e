"""Contact between two triangle meshes: one normal force per contour of contact.

Source: Michaud et al. 2024, section 2.4.1. `pftwin.geometry.contact.contour` computes the geometry. Each contact,
medial and lateral, has one force at the middle of its contour, along the contour's direction; a normal contact law
gives its size from the maximum indentation.
"""

from __future__ import annotations

from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle, half_extent
from pftwin.geometry.contact.behind import Behind, behind
from pftwin.geometry.contact.contact_mesh import ContactMesh
from pftwin.geometry.contact.contour import Contacts, ContourContact, MeshPair, mesh_pair
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.contact import (
    BY_FACET,
    FACETS,
    ButtonMesh,
    NormalForce,
    facet_report,
    force_along,
    load_of,
    vector_sum,
)
from pftwin.model.effects.contact_law import ContactLaw, Speeds

WIDE = 4  # multiple of twice the area of the largest triangle: a contour around a larger area encloses corners


class MeshContact(ButtonMesh):
    """A mesh fixed in the patella against a mesh fixed in the femur."""

    femur: ContactMesh
    patella: ContactMesh
    law: ContactLaw
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))  # of the patella's mesh; axes are the patella's
    surface: Surface | None = None  # smooth substitute that defines the groove, used only for results
    meshes: MeshPair | None = None  # set by `recentred`: arrays prepared for the inner loop
    method: ClassVar[str] = "contours"
    jumps: ClassVar[bool] = True  # the force jumps where a corner or a triangle joins a contour
    observables: ClassVar[dict[str, Observable]] = {
        **BY_FACET,
        "contour_area": Observable("m^2", "area that the contours of contact enclose"),
        "merged": Observable("1", "1 where the medial and the lateral contact are one, which counts as medial"),
        "at_rim": Observable("1", "1 where a contour ends on the rim of an open mesh: beyond it no load is borne"),
        "overflow": Observable("1", "1 where the search ran out of room: the contact may be wrong"),
        "too_deep": Observable("1", "1 where a mesh is too deep in the other for the search: the force is wrong"),
    }

    def contacts(self, now: Instant) -> Contacts:
        """The contacts at an instant, in the femur frame."""
        if self.meshes is None:
            raise TypeError("this mesh contact is not prepared for computing loads: call `recentred` first")
        return self.meshes.contacts(self._pose(now))

    def _pose(self, now: Instant) -> Pose:
        """Pose of the patella's mesh in the femur frame."""
        patella, femur = now.patella, now.femur
        center = femur.to_local(patella.position + patella.arm(self.origin))
        return Pose(center, Quaternion.from_rotation(now.turn_in_femur()))

    def _enclosed(self, now: Instant, found: Contacts) -> list[Behind]:
        """Whether the patella's mesh is wholly behind the femur's, and whether the femur's (possible for an open mesh)
        is wholly inside the patella's: no triangles intersect, and a corner is behind the other surface."""
        pose = self._pose(now)
        pairs = (self.patella, pose.apply, self.femur), (self.femur, pose.unapply, self.patella)
        corners = [place(Vec3.from_array(inner.tree.triangles[0, :3])) for inner, place, _ in pairs]
        return [
            behind(outer.tree.triangles, outer.source, outer.rim, corner, found.pairs == 0)
            for corner, (_, _, outer) in zip(corners, pairs, strict=True)
        ]

    def _corner_missed(self, found: Contacts) -> Array:
        """Whether the search found no corner within reach inside a contour that is wide enough to enclose one."""
        largest = jnp.max(Triangle.of_rows(self.patella.tree.triangles).area_vector().norm())
        missed = [(c.indentation <= 0) & (c.area > WIDE * largest) for c in found.each]
        return jnp.stack(missed).any()

    def normal_law(self) -> ContactLaw:
        """See `Contact`."""
        return self.law

    def remember(self, now: Instant) -> Speeds:
        """Initial memory: no contact has begun."""
        return self.law.no_contact_yet(now.patella.position.x, self.femur.facets)

    def load(self, now: Instant, memory: Speeds) -> tuple[Load, Speeds]:
        """See `Effect`: a stiff term per contact."""
        return load_of(self._normal_forces(now, self.contacts(now), memory))

    def _normal_forces(self, now: Instant, found: Contacts, memory: Speeds) -> list[NormalForce]:
        speeds = memory or (None,) * len(found.each)
        return [self._normal_force(now, c, speed) for c, speed in zip(found.each, speeds, strict=True)]

    def _normal_force(self, now: Instant, contact: ContourContact, approach_speed: Scalar | None) -> NormalForce:
        patella, femur = now.patella, now.femur
        world = femur.direction(contact.normal)
        point = femur.point(contact.point)
        arm = point - patella.position
        velocity = femur.relative_velocity(patella.velocity_at(arm), point)
        moment = patella.rotation.unapply(arm.cross(world))
        return force_along(self.law, now, contact.indentation, -world.dot(velocity), world, moment, approach_speed, 1.0)

    def report(self, now: Instant, memory: Speeds) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`: forces, points and indentations per facet; NaN for a facet without a separate contact."""
        found = self.contacts(now)
        normal_forces = self._normal_forces(now, found, memory)
        forces = [f.term.force for f in normal_forces]
        total = vector_sum([f * c.normal for f, c in zip(forces, found.each, strict=True)])
        indentations = [jnp.where(c.area > 0, c.indentation, jnp.nan) for c in found.each]
        points = [jnp.where(c.area > 0, c.point.array(), jnp.nan) for c in found.each]
        report = facet_report(total, forces, indentations, points)
        report["contour_area"] = sum((c.area for c in found.each[1:]), start=found.each[0].area)
        inside, engulfed = self._enclosed(now, found)
        for k, facet in enumerate(FACETS[: self.femur.facets]):
            # An enclosed mesh has no contour, so its indentation is the distance of a corner to the surface.
            here = inside.there & (self.femur.facet(inside.place) == k)
            report[f"indentation_{facet}"] = jnp.where(here, inside.depth, report[f"indentation_{facet}"])
        medial = report["indentation_medial"]
        report["indentation_medial"] = jnp.where(engulfed.there & ~inside.there, engulfed.depth, medial)
        too_deep = found.too_deep | inside.there | engulfed.there | self._corner_missed(found)
        flags = {"merged": found.merged, "at_rim": found.at_rim, "overflow": found.overflow, "too_deep": too_deep}
        report |= {name: flag.astype(forces[0].dtype) for name, flag in flags.items()}
        return report, load_of(normal_forces)[0].energy

    def button_radius(self) -> Scalar:
        """Half the largest extent of the patella's mesh [m]."""
        return half_extent(self.patella.tree.triangles)

    def femur_triangles(self) -> Array:
        """See `Contact`."""
        return self.femur.tree.triangles

    def button_triangles(self) -> Array:
        """See `Contact`."""
        return self.patella.tree.triangles

    def recentred(self, center_of_mass: Vec3) -> Self:
        """See `Effect`; also prepares the meshes for searches."""
        moved, pair = super().recentred(center_of_mass), mesh_pair(self.femur, self.patella)
        return eqx.tree_at(lambda e: e.meshes, moved, pair, is_leaf=lambda x: x is None)
