"""Sums of forces and pressures over the triangles of an elastic foundation that are in contact.

A loop over the pieces of the button inside the femur ends with the last one, so a light contact is cheap and no list
can overflow. Under differentiation the loop runs over the whole button, and skips pieces that are in contact in no
variant of a batch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.leaves import what_changes
from pftwin.base.spatial import Rotation, Scalar, Vec3
from pftwin.geometry.bvh.loops import member_by_member, most_in_batch
from pftwin.geometry.contact.depth_search import TouchingLeaves
from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface
from pftwin.geometry.contact.depths import REACH, Depths, depths_in
from pftwin.geometry.contact.distance_grid import DistanceGrid
from pftwin.model.effects.foundation_law import FoundationLaw

PIECE = 16  # number of the button's leaves per iteration


class Bedded(eqx.Module):
    """A button, the femur's surface, and their relative pose and motion."""

    femur: PressedSurface | DistanceGrid
    button: PressingSurface
    law: FoundationLaw
    damping_time: Scalar  # [s]
    origin: Vec3  # of the button's mesh, from the patella's centre of mass, patella axes [m]
    position: Vec3  # of the same origin in the femur frame [m]
    rotation: Rotation  # patella to femur
    world: Rotation | None  # femur to world; None if the femur is the world
    twist: Array  # (6,) relative to the femur: velocity of the centre of mass, world axes; spin, patella axes


class Forces(NamedTuple):
    """Sums over the triangles in contact, as in `pftwin.model.effects.base.AggregateStiffness`."""

    force: Array  # (6,)
    elastic: Array  # (6,)
    stiffness: Array  # (6, 6)
    size: Array  # ()
    energy: Array  # () [J]


class Pressures(NamedTuple):
    """Sums and maxima over the triangles in contact; pressures exclude damping."""

    area: Array  # () [m^2]
    borne: Array  # (2,) sum of pressure times area on each facet [N]
    moment: Array  # (2, 3) first moment of pressure times area on each facet, femur frame [N m]
    facets: Array  # (2, 3) force on each facet, femur axes [N]
    most: Array  # () maximum pressure [Pa]
    deepest: Array  # () maximum depth [m]


Sums = tuple[Forces, Pressures]


def triangle_sums(at: Bedded) -> Sums:
    """Sums over all triangles in contact. Supports jit, vmap, and forward and reverse differentiation."""
    found = at.femur.touching(at.button, at.position, at.rotation, width=at.button.leaves, band=0.0, reach=REACH)
    return _sum_contacts(at, found)


@eqx.filter_custom_jvp
def _sum_contacts(at: Bedded, found: TouchingLeaves) -> Sums:
    return member_by_member(_sum_of_all)(at, found)


@_sum_contacts.def_jvp
def _summed_jvp(primals: Any, tangents: Any) -> tuple[Sums, Sums]:
    at, found = primals
    moving, still = what_changes(at, tangents[0])
    most = most_in_batch(found.total)

    def total(moving: Any) -> Sums:
        at = eqx.combine(moving, still)

        def piece(so_far: Sums, start: Array) -> tuple[Sums, None]:
            more = jax.lax.cond(start < most, lambda: _sums_over_leaves(at, found, start), lambda: _zero_sums(at))
            return _added_sums(so_far, more), None

        starts = jnp.arange(0, at.button.leaves, PIECE, dtype=jnp.int32)
        return jax.lax.scan(piece, _zero_sums(at), starts)[0]

    return jax.jvp(total, (moving,), (tangents[0],))


def _sum_of_all(at: Bedded, found: TouchingLeaves) -> Sums:
    def piece(state: tuple[Array, Sums]) -> tuple[Array, Sums]:
        start, so_far = state
        return start + PIECE, _added_sums(so_far, _sums_over_leaves(at, found, start))

    return jax.lax.while_loop(lambda s: s[0] < found.total, piece, (jnp.zeros((), jnp.int32), _zero_sums(at)))[1]


def _zero_sums(at: Bedded) -> Sums:
    def zeros(*shape: int) -> Array:
        return jnp.zeros(shape, at.position.x.dtype)

    forces = Forces(zeros(6), zeros(6), zeros(6, 6), zeros(), zeros())
    return forces, Pressures(zeros(), zeros(2), zeros(2, 3), zeros(2, 3), zeros(), zeros())


def _added_sums(one: Sums, other: Sums) -> Sums:
    forces, pressures = jax.tree.map(jnp.add, one, other)
    most, deepest = (jnp.maximum(getattr(one[1], n), getattr(other[1], n)) for n in ("most", "deepest"))
    return forces, pressures._replace(most=most, deepest=deepest)


def _sums_over_leaves(at: Bedded, found: TouchingLeaves, start: Array) -> Sums:
    """Sums over the piece of leaves that begins at `start`."""
    # The last piece starts early enough to be full, and counts only leaves that no other piece has counted.
    first = jnp.minimum(start, max(at.button.leaves - PIECE, 0))
    leaf, place = (jax.lax.dynamic_slice_in_dim(x, first, min(PIECE, at.button.leaves)) for x in found[:2])
    number = first + jnp.arange(leaf.shape[0], dtype=jnp.int32)
    there = (number >= start) & (number < found.total)
    d = depths_in(at.button, at.femur, at.position, at.rotation, leaf, place, there)
    rows = _wrenches(at, d, d.normal)
    # Per triangle; all zero without contact.
    pressure, slope, stored = at.law.press(jnp.where(d.listed, d.depth, -1.0))
    elastic, stiffness = d.area * pressure, d.area * slope
    force = elastic - at.damping_time * stiffness * (at.twist @ rows)
    kept = jnp.where(force > 0, stored, 0.0)
    force, elastic, stiffness = (jnp.where(force > 0, a, 0.0) for a in (force, elastic, stiffness))
    # Contribution of the changing projected areas, so that forces and moments are the derivatives of the energy.
    moved = _wrenches(at, d, d.sliding) @ kept
    turning = moved + jnp.concatenate([jnp.zeros(3, kept.dtype), kept @ d.tilting.array()])
    forces = Forces(
        force=rows @ force + turning,
        elastic=rows @ elastic + turning,
        stiffness=(rows * stiffness[None, :]) @ rows.T,
        size=jnp.sum(force),
        energy=jnp.sum(d.area * stored),
    )
    touching = d.listed & (d.depth > 0)
    facet = jnp.zeros_like(d.triangle) if d.facet is None else d.facet
    on = jnp.stack([facet == k for k in range(2)])  # (2, triangles)
    borne_on = jnp.where(on, d.area * pressure, 0.0)
    pressures = Pressures(
        area=jnp.sum(jnp.where(touching, d.area, 0.0)),
        borne=jnp.sum(borne_on, axis=1),
        moment=borne_on @ d.point.array(),
        facets=jnp.sum(jnp.where(on[:, None, :], (force * d.normal + kept * d.sliding).array().T, 0.0), axis=2),
        most=jnp.max(pressure),
        deepest=jnp.max(jnp.where(touching, d.depth, 0.0)),
    )
    return forces, pressures


def _wrenches(at: Bedded, d: Depths, forces: Vec3) -> Array:
    """Wrenches (6, triangles) of forces at the centroids (femur axes): force in world axes, and moment about the centre
    of mass in patella axes."""
    arm = d.local + Vec3(*(jnp.broadcast_to(a, d.depth.shape) for a in (at.origin.x, at.origin.y, at.origin.z)))
    moment = arm.cross(at.rotation.unapply(forces))
    direction = forces if at.world is None else at.world.apply(forces)
    return jnp.concatenate([direction.array(), moment.array()], axis=-1).T
