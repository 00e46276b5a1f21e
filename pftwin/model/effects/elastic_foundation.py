r"""Elastic foundation contact between the meshes of button and femur, with a pressure on every triangle in contact.

A triangle whose centroid is at depth d exerts the force A p(d) along the femur's normal n there, where A is its area
projected along n. The forces derive from the potential sum_i A_i w(d_i), with w the law's energy per area, which adds
a moment w dA/dangle: see docs/mesh_contact.md. (Where the nearest point is on an edge, n also turns with the centroid;
this is neglected.) There is no friction. Source: Bei and Fregly 2004, Med Eng Phys 26:777; see
`pftwin.model.effects.foundation_law`. The search for triangles and depths is in `pftwin.geometry.contact.depths`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Quaternion, Rotation, Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle, half_extent
from pftwin.geometry.contact.behind import behind
from pftwin.geometry.contact.depth_search import centroid
from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface
from pftwin.geometry.contact.depths import DEEPEST
from pftwin.geometry.contact.distance_grid import DistanceGrid
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import AggregateStiffness, Ground, Instant, Load, Observable
from pftwin.model.effects.contact import FACETS, FORCE, ButtonMesh
from pftwin.model.effects.foundation_law import FoundationLaw
from pftwin.model.effects.foundation_sums import PressedPair, Pressures, triangle_sums


class ElasticFoundation(ButtonMesh):
    """Contact between two meshes with an elastic layer on each.

    A triangle of the button bears the pressure p(d) + c p'(d) dd/dt, at least 0, with c the `damping_time` [s]. The
    load is their sum, as one aggregate stiffness.
    """

    femur: PressedSurface | DistanceGrid  # in the femur's frame
    button: PressingSurface
    law: FoundationLaw
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))  # of the button's mesh, axes parallel
    damping_time: Scalar | float = eqx.field(default=0.0, metadata=quantity("s", at_least=0))  # c
    surface: Surface | None = None  # smooth substitute that defines the groove, used only for results
    placement: Vec3 = eqx.field(  # offset of the mesh from `origin`: bone and cartilage are registered to each other
        default_factory=Vec3.zero, metadata=quantity("m", frame="patella")
    )
    # Rotation vector of the mesh about its origin, patella axes; None: the mesh's axes are parallel to the patella's.
    turn: Vec3 | None = eqx.field(default=None, metadata=quantity("rad"))
    method: ClassVar[str] = "foundation"
    observables: ClassVar[dict[str, Observable]] = {
        **FORCE,
        "force": Observable("N", "size of the contact force"),
        "area": Observable("m^2", "contact area"),
        "mean_pressure": Observable("Pa", "mean pressure over the contact area"),
        "max_pressure": Observable("Pa", "maximum pressure"),
        "center_of_pressure": Observable("m", "centre of pressure, femur frame"),
        "indentation": Observable("m", "depth of the deepest triangle"),
        "force_medial": Observable("N", "size of the force on the medial facet"),
        "force_lateral": Observable("N", "size of the force on the lateral facet"),
        "point_medial": Observable("m", "centre of pressure on the medial facet, femur frame"),
        "point_lateral": Observable("m", "centre of pressure on the lateral facet, femur frame"),
        "too_deep": Observable("1", "1 where a triangle is implausibly deep, or too deep for the search"),
    }

    def pressed(self, now: Instant) -> PressedPair:
        """The button and the femur's surface with their relative pose and motion, for `triangle_sums`."""
        patella, femur = now.patella, now.femur
        velocity = femur.relative_velocity(patella.velocity, patella.position)
        spin = femur.relative_spin(patella.spin, patella.rotation)
        origin, rotation = self.origin + self.placement, now.turn_in_femur()
        position = femur.to_local(patella.position + patella.arm(origin))
        if (turn := self._turn()) is not None:
            origin, spin = turn.unapply(origin), turn.unapply(spin)
            rotation = Rotation(*(rotation.apply(axis) for axis in (turn.ex, turn.ey, turn.ez)))
        return PressedPair(
            femur=self.femur,
            button=self.button,
            law=self.law,
            damping_time=jnp.asarray(self.damping_time, patella.position.x.dtype),
            origin=origin,
            position=position,
            rotation=rotation,
            world=None if isinstance(femur, Ground) else femur.rotation,
            twist=jnp.concatenate([velocity.array(), spin.array()]),
        )

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: the forces of all triangles, as one aggregate stiffness."""
        at = self.pressed(now)
        found, twist = triangle_sums(at)[0], at.twist
        if (turn := self._turn()) is not None:  # moments and spin from the mesh's axes to the patella's
            turned = jnp.eye(6, dtype=twist.dtype).at[3:, 3:].set(turn.array())
            force, elastic, twist = (turned @ six for six in (found.force, found.elastic, twist))
            found = found._replace(force=force, elastic=elastic, stiffness=turned @ found.stiffness @ turned.T)
        velocity, spin = Vec3.from_array(twist[:3]), Vec3.from_array(twist[3:])
        bed = AggregateStiffness(
            found.force, found.elastic, found.stiffness, at.damping_time, found.size, velocity, spin
        )
        return Load(bed=bed, energy=found.energy), memory

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar]:
        """See `Effect`: force, area, pressures and centres of pressure; values undefined without contact are NaN."""
        at = self.pressed(now)
        forces, p = triangle_sums(at)
        total = Vec3.from_array(jnp.sum(p.facets, axis=0))
        borne = jnp.sum(p.borne)
        some = borne > 0
        too_deep = (p.deepest > DEEPEST) | self._enclosed(at, p)
        report = {
            "force": total.norm(),
            "force_x": total.x,
            "force_y": total.y,
            "force_z": total.z,
            "area": p.area,
            "mean_pressure": jnp.where(some, borne / jnp.where(some, p.area, 1.0), 0.0),
            "max_pressure": p.most,
            "center_of_pressure": jnp.where(some, jnp.sum(p.moment, axis=0) / jnp.where(some, borne, 1.0), jnp.nan),
            "indentation": jnp.where(p.deepest > 0, p.deepest, jnp.nan),
            "too_deep": too_deep.astype(p.deepest.dtype),
        }
        for k, facet in enumerate(FACETS):  # a single facet counts as medial
            loaded = p.borne[k] > 0
            report[f"force_{facet}"] = Vec3.from_array(p.facets[k]).norm()
            report[f"point_{facet}"] = jnp.where(loaded, p.moment[k] / jnp.where(loaded, p.borne[k], 1.0), jnp.nan)
        return report, forces.energy

    def _enclosed(self, at: PressedPair, found: Pressures) -> Array:
        """Whether the button is too deep for the search: no triangle is in contact, but one is behind the surface."""
        middle = at.position + at.rotation.apply(centroid(Triangle.of_rows(self.button.corners[0, :, 0])))
        femur = self.femur.exact
        return behind(femur.corners, femur.triangle, femur.rim_edges(), middle, found.area == 0).there

    def button_radius(self) -> Scalar:
        """Half the largest extent of the button's mesh [m]."""
        return half_extent(self.button.mesh)

    def pressure(self, depth: Scalar) -> Scalar:
        """See `Contact`."""
        return self.law.press(depth).pressure

    def femur_triangles(self) -> Array:
        """See `Contact`."""
        return self.femur.exact.corners

    def button_triangles(self) -> Array:
        """See `Contact`."""
        corners, turn = Vec3.from_array(self.button.mesh.reshape(-1, 3, 3)), self._turn()
        placed = self.placement + (corners if turn is None else turn.apply(corners))
        return placed.array().reshape(-1, 9)

    def _turn(self) -> Rotation | None:
        """From the mesh's axes to the patella's."""
        return None if self.turn is None else Quaternion.from_rotation_vector(self.turn).rotation()
