r"""Contact of a spherical button with a triangle mesh from the volume of their overlap, smooth enough for gradients.

The overlap volume V of a facet and the sphere (the integral of the depth over the part of the facet inside the sphere)
defines the indentation. For a paraboloidal gap, as between smooth surfaces, V = pi r d^2, where the effective radius r
is one over the square root of the product of the gap's curvatures (for a sphere of radius R on a plane, r = R). So

    d = sqrt(V / (pi r)),       F = k d^p (1 + x dd/dt)       along  -grad d,

where k, p and x belong to the contact law and the gradient is with respect to the sphere's centre. The elastic force
has a potential, and V has continuous second derivatives where triangles, edges or corners enter or leave the sphere.
As r is constant, k is the stiffness at that radius. `effective_radius` computes r on a mesh.

The medial and the lateral facet have separate volumes V_m and V_l and each bears the force of the law. Where both
form one contact across their border, the law applies to V_m + V_l, and the two share its force. A blend of the
potentials joins these cases smoothly, depending on the depth of the border inside the sphere,

    U = (1 - s) (u(V_m) + u(V_l)) + s u(V_m + V_l),      s from 0 to 1 with   depth^2 pi r (1 / V_m + 1 / V_l),

a number that is at least 4 where the border crosses a single contact and tends to 0 where two contacts separate.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.leaves import traced_once
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.contact.overlap import Overlap, overlap
from pftwin.geometry.contact.patch_mesh import PatchMesh
from pftwin.geometry.contact.sphere_patch import sphere_patch
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import Instant, Load, Observable, StiffTerm, applied_at
from pftwin.model.effects.contact import BY_FACET, FACETS, ButtonSphere, Contact, facet_report
from pftwin.model.effects.contact_law import ContactLaw, Speeds
from pftwin.model.effects.friction import Friction, WithFriction


class VolumeTouch(NamedTuple):
    """Contact of the sphere with the mesh at an instant."""

    overlap: Overlap
    terms: tuple[StiffTerm, ...]  # of the medial and the lateral facet, and of the blend between two contacts and one
    energy: Scalar
    speeds: Speeds


class MeshVolumeContact(ButtonSphere):
    """A sphere fixed in the patella against a mesh fixed in the femur, with a force from their overlap volume."""

    mesh: PatchMesh
    law: ContactLaw
    center: Vec3 = eqx.field(metadata=quantity("m", frame="patella", words="centre of the button"))
    radius: Scalar = eqx.field(metadata=quantity("m", positive=True, words="radius of the button"))
    effective_radius: Scalar = eqx.field(
        metadata=quantity("m", positive=True, words="radius of the law")
    )  # r, at which the law's stiffness applies
    surface: Surface | None = None  # smooth substitute that defines the groove, used only for results
    method: ClassVar[str] = "volume"
    observables: ClassVar[dict[str, Observable]] = {
        **BY_FACET,
        "area_medial": Observable("m^2", "area of the medial facet inside the sphere"),
        "area_lateral": Observable("m^2", "area of the lateral facet inside the sphere"),
        "off_patch": Observable("m", "half the length of the mesh's rim that lies inside the sphere"),
        "overflow": Observable("1", "1 where the search ran out of room: the contact is wrong"),
    }

    def remember(self, now: Instant) -> Speeds:
        """Initial memory: no contact has begun."""
        return self.law.no_contact_yet(now.patella.position.x, 2)

    @traced_once
    def touch(self, now: Instant, memory: Speeds) -> VolumeTouch:
        """The overlap at an instant, and its forces."""
        centre, velocity = self.centre_in_femur(now)
        found = overlap(sphere_patch(self.mesh, centre, self.radius), self.radius, self.effective_radius)
        speeds, s = memory or (None, None), found.merged
        of_both = None if memory is None else jnp.maximum(*memory)
        rates = [-n.dot(velocity) for n in found.normals]
        rate = found.parts[0] * rates[0] + found.parts[1] * rates[1]
        terms, begun, energies = [], [], []
        for n, d, part, own, speed in zip(found.normals, found.depths, found.parts, rates, speeds, strict=True):
            separate = self.normal_force(now, n, d, own, speed, 1 - s)
            joint = self.normal_force(now, n, found.joint_depth, rate, of_both, s * part)
            terms.append(_combined_term(separate.term, joint.term))
            energies.append(self.law.force(d, jnp.zeros_like(d), of_both).energy)
            if separate.approach_speed is not None and joint.approach_speed is not None:
                one = jnp.where(
                    s > 0, jnp.maximum(separate.approach_speed, joint.approach_speed), separate.approach_speed
                )
                begun.append(jnp.where(d > 0, one, 0.0))
        joint_energy = self.law.force(found.joint_depth, jnp.zeros_like(rate), of_both).energy
        gained = joint_energy - energies[0] - energies[1]
        if self.mesh.facets.count > 1:
            terms.append(self._blend_term(now, found, gained, velocity))
        energy = energies[0] + energies[1] + s * gained
        return VolumeTouch(found, tuple(terms), energy, tuple(begun) or None)

    def _blend_term(self, now: Instant, found: Overlap, gained: Scalar, velocity: Vec3) -> StiffTerm:
        """Force from the dependence of the potential on s: `gained` [J] times -grad s [1/m]."""
        world = now.femur.direction(-found.merged_slope)
        zero = jnp.zeros_like(gained)
        rate = found.merged_slope.dot(velocity)
        return StiffTerm(world, applied_at(self.center, now.patella, world), gained, gained, zero, zero, rate)

    def load(self, now: Instant, memory: Speeds) -> tuple[Load, Speeds]:
        """See `Effect`: a stiff term per facet, and one for the blend between two contacts and one."""
        t = self.touch(now, memory)
        return Load(stiff=t.terms, energy=t.energy), t.speeds

    def femur_triangles(self) -> Array:
        """See `Contact`."""
        return self.mesh.facets.triangles

    def with_friction(self, friction: Friction) -> Contact:
        """See `Contact`."""
        return RoughMeshVolumeContact.of(self, friction)

    def recentred(self, center_of_mass: Vec3) -> Self:
        """See `Effect`; also prepares the mesh for repeated searches."""
        return eqx.tree_at(lambda e: e.mesh, super().recentred(center_of_mass), self.mesh.prepared())

    def report(self, now: Instant, memory: Speeds) -> tuple[dict[str, Any], Scalar | None]:
        """See `Effect`: forces, points and indentations per facet; NaN for a facet without contact."""
        t, (centre, _) = self.touch(now, memory), self.centre_in_femur(now)
        found, deep = t.overlap, self.mesh.depth_by_distance(centre, self.radius)
        total = sum((term.force * term.direction for term in t.terms), start=Vec3.zero())
        whole = total.norm()
        along = (1 / jnp.where(whole > 0, whole, 1.0)) * total
        forces, indentations, points = [], [], []
        for k, area in enumerate(found.areas):
            # The forces of the two parts of one contact diverge; their contribution is the component along the total.
            force = t.terms[k].force * t.terms[k].direction
            size = (1 - found.merged) * force.norm() + found.merged * force.dot(along)
            d = jnp.where(found.merged > 0, found.joint_depth, found.depths[k])
            inside = found.arms[k] * (1 / jnp.where(area > 0, area, 1.0))
            forces.append(size)
            points.append(jnp.where(size > 0, (centre + inside).array(), jnp.nan))
            # A sphere wholly inside the bone contains no surface; its depth is the distance to the surface.
            indentations.append(jnp.where(area > 0, d, jnp.where(deep[k] > self.radius, deep[k], jnp.nan)))
        report = facet_report(now.femur.local_direction(total), forces, indentations, points)
        report |= {f"area_{facet}": area for facet, area in zip(FACETS, found.areas, strict=True)}
        loaded = (forces[0] > 0) | (forces[1] > 0)
        rim = jnp.where(loaded, 0.5 * self.mesh.rim_inside(centre, self.radius), 0.0)
        return {**report, "off_patch": rim, "overflow": found.overflow.astype(whole.dtype)}, t.energy


class RoughMeshVolumeContact(WithFriction, MeshVolumeContact):
    """`MeshVolumeContact` with friction on every facet."""

    frictionless: ClassVar[type[Contact]] = MeshVolumeContact
    observables: ClassVar[dict[str, Observable]] = {**MeshVolumeContact.observables, **WithFriction.tangential}


def _combined_term(a: StiffTerm, b: StiffTerm) -> StiffTerm:
    """Sum of two terms along the same direction, as one term."""
    added = {name: getattr(a, name) + getattr(b, name) for name in ("force", "elastic", "stiffness", "damping")}
    return dataclasses.replace(a, **added)
