r"""The button's mesh on the femur's mesh, each with an elastic layer: pressure on every triangle that is in contact.

A triangle of area A whose centroid is d deep pushes with A p(d) along the femur's normal there, n, which is minus the
depth's gradient: the forces have the potential sum_i A_i w(d_i), with w the law's energy per area. Friction there is
none. Source: Bei and Fregly 2004, Med Eng Phys 26:777; see `pftwin.effects.foundation_law`. How triangles and depths
are found: `pftwin.surfaces.depths`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.effects.base import Bed, Effect, Ground, Instant, Load, Observable
from pftwin.effects.foundation_law import FoundationLaw
from pftwin.effects.foundation_sums import Bedded, Forces, sums
from pftwin.spatial import Rotation, Scalar, Vec3
from pftwin.surfaces.depth_sides import PressedSurface, PressingSurface
from pftwin.surfaces.depths import DEEPEST

FACETS = ("medial", "lateral")


class ElasticFoundation(Effect):
    """Two meshes with a layered elastic foundation between them.

    A triangle of the button bears p(d) + c p'(d) dd/dt, never below 0, with c a `damping_time` [s]. The triangles are
    one group of stiff terms. `leaves` is the room for pieces of the button that may be in contact at a time (None: for
    all of it); where it is too short the load is NaN and `overflow` is reported, never a force that lacks a part.
    """

    femur: PressedSurface  # in the femur's frame
    button: PressingSurface
    law: FoundationLaw
    origin: Vec3  # of the button's mesh, patella frame, axes parallel [m]
    damping_time: Scalar | float = 0.0  # c [s]
    name: str = eqx.field(static=True, kw_only=True, default="contact")
    observables: ClassVar[dict[str, Observable]] = {
        "force": Observable("N", "size of the contact force"),
        "force_x": Observable("N", "contact force on the patella, femur x"),
        "force_y": Observable("N", "contact force on the patella, femur y"),
        "force_z": Observable("N", "contact force on the patella, femur z"),
        "area": Observable("m^2", "contact area"),
        "mean_pressure": Observable("Pa", "mean pressure over the contact area"),
        "max_pressure": Observable("Pa", "maximum pressure"),
        "center_of_pressure": Observable("m", "centre of pressure, femur frame"),
        "depth": Observable("m", "depth of the deepest triangle"),
        "force_medial": Observable("N", "size of the force on the medial facet"),
        "force_lateral": Observable("N", "size of the force on the lateral facet"),
        "too_deep": Observable("1", "whether a triangle is deeper than any joint bears"),
    }

    def pressed(self, now: Instant) -> Bedded:
        """Where the button is in the femur, and how both move."""
        patella, femur = now.patella, now.femur
        position = femur.to_local(patella.position + patella.arm(self.origin))
        axes = patella.rotation
        rotation = Rotation(*(femur.local_direction(a) for a in (axes.ex, axes.ey, axes.ez)))
        velocity, spin, world = femur.relative_velocity(patella.velocity, patella.position), patella.spin, None
        if not isinstance(femur, Ground):
            spin = spin - axes.unapply(femur.angular_velocity)
            world = femur.rotation
        twist = jnp.concatenate([velocity.array(), spin.array()])
        damping_time = jnp.asarray(self.damping_time, position.x.dtype)
        return Bedded(self.femur, self.button, self.law, damping_time, self.origin, position, rotation, world, twist)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """All triangles' pushes as one bed."""
        at = self.pressed(now)
        return _load(at, sums(at)[0]), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Force, area, pressures, and where they press; NaN where nothing is in contact and they have no meaning."""
        return self.report(now, memory)[0]

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar]:
        """What `observe` shows, and the energy stored."""
        forces, p = sums(self.pressed(now))
        push = Vec3.from_array(jnp.sum(p.facets, axis=0))
        some = p.borne > 0
        report = {
            "force": push.norm(),
            "force_x": push.x,
            "force_y": push.y,
            "force_z": push.z,
            "area": p.area,
            "mean_pressure": jnp.where(some, p.borne / jnp.where(some, p.area, 1.0), 0.0),
            "max_pressure": p.most,
            "center_of_pressure": jnp.where(some, p.moment / jnp.where(some, p.borne, 1.0), jnp.nan),
            "depth": p.deepest,
            "too_deep": (p.deepest > DEEPEST).astype(p.deepest.dtype),
        }
        for share, facet in zip(p.facets, FACETS, strict=True):
            report[f"force_{facet}"] = Vec3.from_array(share).norm()
        return report, forces.energy

    def about(self, center_of_mass: Vec3) -> ElasticFoundation:
        """The button's frame counted from the centre of mass."""
        return eqx.tree_at(lambda e: e.origin, self, self.origin - center_of_mass)


def _load(at: Bedded, forces: Forces) -> Load:
    bed = Bed(
        forces.force,
        forces.elastic,
        forces.stiffness,
        at.damping_time,
        forces.size,
        Vec3.from_array(at.twist[:3]),
        Vec3.from_array(at.twist[3:]),
    )
    return Load(bed=bed, energy=forces.energy)
