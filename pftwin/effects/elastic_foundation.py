r"""The button's mesh on the femur's mesh, each with an elastic layer: pressure on every triangle that is in contact.

A triangle of area A whose centroid is d deep pushes with A p(d) along the femur's normal there, n, which is minus the
depth's gradient: the forces have the potential sum_i A_i w(d_i), with w the law's energy per area. Friction there is
none. Source: Bei and Fregly 2004, Med Eng Phys 26:777; see `pftwin.effects.foundation_law`. How triangles and depths
are found: `pftwin.surfaces.depths`.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.effects.base import Effect, Instant, Load, Observable, StiffTerm, applied_at
from pftwin.effects.foundation_law import FoundationLaw, FoundationPressure
from pftwin.spatial import Rotation, Scalar, Vec3
from pftwin.surfaces.behind import behind
from pftwin.surfaces.closest import Surface
from pftwin.surfaces.depth_search import centroid
from pftwin.surfaces.depth_sides import PressedSurface, PressingSurface
from pftwin.surfaces.depths import DEEPEST, Depths, depths
from pftwin.surfaces.triangle import Triangle

FACETS = ("medial", "lateral")

Memory = Scalar | None  # 1 once the list of triangles was too short; None where it has room for all


class Pressed(NamedTuple):
    """Contact at an instant: a group of triangles."""

    depths: Depths
    answer: FoundationPressure  # 0 where a triangle is not in contact
    term: StiffTerm


class ElasticFoundation(Effect):
    """Two meshes with a layered elastic foundation between them.

    A triangle of the button bears p(d) + c p'(d) dd/dt, never below 0, with c a `damping_time` [s]. The triangles are
    one group of stiff terms. `leaves` is the room for pieces of the button that may be in contact at a time (None: for
    all of it); where it is too short the load is NaN and `overflow` is reported, never a force that lacks a part. The
    memory is whether it was too short before.
    """

    femur: PressedSurface  # in the femur's frame
    button: PressingSurface
    law: FoundationLaw
    origin: Vec3  # of the button's mesh, patella frame, axes parallel [m]
    damping_time: Scalar | float = 0.0  # c [s]
    leaves: int | None = eqx.field(static=True, default=None)
    surface: Surface | None = None  # a smooth stand-in that tells where the groove is: for results alone
    name: str = eqx.field(static=True, kw_only=True, default="contact")
    method: ClassVar[str] = "foundation"
    observables: ClassVar[dict[str, Observable]] = {
        "force": Observable("N", "size of the contact force"),
        "force_x": Observable("N", "contact force on the patella, femur x"),
        "force_y": Observable("N", "contact force on the patella, femur y"),
        "force_z": Observable("N", "contact force on the patella, femur z"),
        "area": Observable("m^2", "contact area"),
        "mean_pressure": Observable("Pa", "mean pressure over the contact area"),
        "max_pressure": Observable("Pa", "maximum pressure"),
        "center_of_pressure": Observable("m", "centre of pressure, femur frame"),
        "indentation": Observable("m", "depth of the deepest triangle"),
        "force_medial": Observable("N", "size of the force on the medial facet"),
        "force_lateral": Observable("N", "size of the force on the lateral facet"),
        "too_deep": Observable("1", "whether a triangle is deeper than any joint bears, or than is looked for"),
        "overflow": Observable("1", "whether the list of triangles is or was too short, and the load is not known"),
    }

    def remember(self, now: Instant) -> Memory:
        """Nothing was lost yet."""
        return None if self.leaves is None else jnp.zeros_like(now.patella.position.x)

    def _place(self, now: Instant) -> tuple[Vec3, Rotation]:
        """Of the button's frame in the femur's."""
        patella, femur = now.patella, now.femur
        turn = patella.rotation
        axes = Rotation(*(femur.local_direction(a) for a in (turn.ex, turn.ey, turn.ez)))
        return femur.to_local(patella.position + patella.arm(self.origin)), axes

    def pressed(self, now: Instant) -> Pressed:
        """Every triangle in contact, with its law's answer and its stiff term."""
        patella, femur = now.patella, now.femur
        position, rotation = self._place(now)
        found = depths(self.button, self.femur, position, rotation, leaves=self.leaves)
        answer = self.law.press(jnp.where(found.listed, found.depth, -1.0))
        arm = found.local + Vec3(*(jnp.broadcast_to(a, found.depth.shape) for a in _parts(self.origin)))
        direction = now.femur.direction(found.normal)
        at = patella.arm(arm)
        velocity = femur.relative_velocity(patella.velocity_at(at), patella.position + at)
        rate = -direction.dot(velocity)
        elastic = found.area * answer.pressure
        damping = found.area * answer.slope * self.damping_time
        pushes = elastic + damping * rate > 0
        known = jnp.where(found.overflow, jnp.nan, 1.0)
        force, elastic, stiffness, damping = (
            known * jnp.where(pushes, a, 0.0)
            for a in (elastic + damping * rate, elastic, found.area * answer.slope, damping)
        )
        term = StiffTerm(direction, applied_at(arm, patella, direction), force, elastic, stiffness, damping, rate)
        return Pressed(found, answer, term)

    def load(self, now: Instant, memory: Memory) -> tuple[Load, Memory]:
        """All triangles' pushes as one group of stiff terms."""
        found = self.pressed(now)
        return Load(stiff=(found.term,), energy=_stored(found)), _with_lost(memory, found.depths)

    def observe(self, now: Instant, memory: Memory) -> dict[str, Scalar]:
        """Force, area, pressures, and where they press; NaN where nothing is in contact and they have no meaning."""
        return self.report(now, memory)[0]

    def report(self, now: Instant, memory: Memory) -> tuple[dict[str, Scalar], Scalar]:
        """What `observe` shows, and the energy stored."""
        pressed = self.pressed(now)
        found, answer, term = pressed
        report = summary(found, answer.pressure)
        depth, lost = report.pop("depth"), _with_lost(memory, found)
        report["indentation"] = jnp.where(depth > 0, depth, jnp.nan)
        report["overflow"] = report["overflow"] if lost is None else lost
        report["too_deep"] = jnp.maximum(report["too_deep"], self._swallowed(now, found).astype(depth.dtype))
        push = now.femur.local_direction(term.wrench().force)
        unknown = jnp.where(report["overflow"] > 0, jnp.nan, 0.0)
        out = {"force": push.norm() + unknown, "force_x": push.x, "force_y": push.y, "force_z": push.z, **report}
        for k, facet in enumerate(FACETS):  # a mesh of one facet calls it medial
            share = jnp.where((0 if found.facet is None else found.facet) == k, term.force, 0.0)
            out[f"force_{facet}"] = (share * term.direction).sum().norm() + unknown
        return out, _stored(pressed)

    def _swallowed(self, now: Instant, found: Depths) -> Array:
        """Whether the button is deeper than is looked for: no triangle is listed, and any of them is behind."""
        position, rotation = self._place(now)
        middle = position + rotation.apply(centroid(Triangle.of_rows(self.button.corners[0])))
        nothing = ~found.listed.any() & ~found.overflow
        return behind(self.femur.corners, self.femur.triangle, middle, nothing)

    def followed(self) -> Vec3:
        """The origin of the button's mesh: the middle of a sphere."""
        return self.origin

    def about(self, center_of_mass: Vec3) -> ElasticFoundation:
        """The button's frame counted from the centre of mass."""
        return eqx.tree_at(lambda e: e.origin, self, self.origin - center_of_mass)


def _stored(found: Pressed) -> Scalar:
    stored = jnp.sum(found.depths.area * found.answer.energy)
    return jnp.where(found.depths.overflow, jnp.nan, stored)


def _with_lost(memory: Memory, found: Depths) -> Memory:
    return None if memory is None else jnp.maximum(memory, found.overflow.astype(memory.dtype))


def summary(found: Depths, pressure: Scalar) -> dict[str, Scalar]:
    """Area, pressures, centre of pressure (femur frame), depth and reservations of a contact."""
    touching = found.listed & (found.depth > 0)
    area = jnp.sum(jnp.where(touching, found.area, 0.0))
    borne = jnp.where(touching, found.area * pressure, 0.0)
    total = jnp.sum(borne)
    some = total > 0
    deepest = jnp.max(jnp.where(touching, found.depth, 0.0))
    center = (1 / jnp.where(some, total, 1.0)) * (borne * found.point).sum()
    return {
        "area": area,
        "mean_pressure": jnp.where(some, total / jnp.where(some, area, 1.0), 0.0),
        "max_pressure": jnp.max(jnp.where(touching, pressure, 0.0)),
        "center_of_pressure": jnp.where(some, center.array(), jnp.nan),
        "depth": deepest,
        "too_deep": (deepest > DEEPEST).astype(deepest.dtype),
        "overflow": found.overflow.astype(deepest.dtype),
    }


def _parts(v: Vec3) -> tuple[Scalar, Scalar, Scalar]:
    return v.x, v.y, v.z
