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
import numpy as np
from jaxtyping import Array

from pftwin.base.leaves import split_by_tangent
from pftwin.base.spatial import Rotation, Scalar, Vec3
from pftwin.geometry.bvh.loops import member_by_member, most_in_batch
from pftwin.geometry.contact.depth_search import TouchingLeaves
from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface
from pftwin.geometry.contact.depths import MAX_DEPTH, Depths, depths_in
from pftwin.geometry.contact.distance_grid import DistanceGrid
from pftwin.model.effects.foundation_law import FoundationLaw

PIECE = 4  # number of the button's leaves per iteration
# Of a symmetric matrix (6, 6): rows and columns of its lower triangle, and the place in it of every element.
_ROWS, _COLUMNS = np.tril_indices(6)
_PLACE = np.zeros((6, 6), int)
_PLACE[_ROWS, _COLUMNS] = _PLACE[_COLUMNS, _ROWS] = range(len(_ROWS))


class PressedPair(eqx.Module):
    """A button, the femur's surface, and their relative pose and motion."""

    femur: PressedSurface | DistanceGrid
    button: PressingSurface
    law: FoundationLaw
    damping_time: Scalar  # [s]
    origin: Vec3  # of the button's mesh, from the patella's centre of mass, axes of the mesh [m]
    position: Vec3  # of the same origin in the femur frame [m]
    rotation: Rotation  # axes of the mesh to femur
    world: Rotation | None  # femur to world; None if the femur is the world
    twist: Array  # (6,) relative to the femur: velocity of the centre of mass, world axes; spin, axes of the mesh


class Forces(NamedTuple):
    """Sums over the triangles in contact, as in `pftwin.model.effects.base.AggregateStiffness`, but with moments in the
    axes of the button's mesh."""

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


class Lanes(NamedTuple):
    """Sums and maxima over every n-th triangle, arrays (n,), so that a loop adds several with one instruction; or over
    all triangles, arrays ()."""

    force: list[Array]  # 6
    elastic: list[Array]  # 6
    stiffness: list[Array]  # 21, the lower triangle
    size: Array
    energy: Array
    area: Array
    borne: list[Array]  # one on each facet
    moment: list[list[Array]]  # 3 on each facet
    facets: list[list[Array]]
    most: Array
    deepest: Array

    def plus(self, other: Lanes) -> Lanes:
        """The sums and maxima of both."""
        most, deepest = (jnp.maximum(a, b) for a, b in ((self.most, other.most), (self.deepest, other.deepest)))
        return jax.tree.map(jnp.add, self, other)._replace(most=most, deepest=deepest)

    def total(self) -> Lanes:
        """Over all triangles, as arrays ()."""
        return jax.tree.map(jnp.sum, self)._replace(most=jnp.max(self.most), deepest=jnp.max(self.deepest))

    def stacked(self) -> tuple[Forces, Pressures]:
        """Of a total, as vectors and matrices."""
        force, elastic, triangle, borne = (jnp.stack(x) for x in (self.force, self.elastic, self.stiffness, self.borne))
        forces = Forces(force, elastic, triangle[_PLACE], self.size, self.energy)
        moment, facets = (jnp.stack([jnp.stack(v) for v in per_facet]) for per_facet in (self.moment, self.facets))
        return forces, Pressures(self.area, borne, moment, facets, self.most, self.deepest)


def triangle_sums(at: PressedPair) -> tuple[Forces, Pressures]:
    """Sums over all triangles in contact. Supports jit, vmap, and forward and reverse differentiation."""
    found = at.femur.touching(at.button, at.position, at.rotation, width=at.button.leaves, band=0.0, limit=MAX_DEPTH)
    return _sum_contacts(at, found).stacked()


# Under vmap the axis of the batch must be in the same place in a result and in what its derivative rule returns: JAX
# does not check that, and `jnp.stack` puts it elsewhere than the loop over members does. So both return arrays ().
@eqx.filter_custom_jvp
def _sum_contacts(at: PressedPair, found: TouchingLeaves) -> Lanes:
    return member_by_member(_sum_of_all)(at, found)


@_sum_contacts.def_jvp
def _summed_jvp(primals: Any, tangents: Any) -> tuple[Lanes, Lanes]:
    at, found = primals
    moving, still = split_by_tangent(at, tangents[0])
    most = most_in_batch(found.total)

    def total(moving: Any) -> Lanes:
        at = eqx.combine(moving, still)
        zero = _zero_lanes(at)

        def piece(so_far: Lanes, start: Array) -> tuple[Lanes, None]:
            more = jax.lax.cond(start < most, lambda: _lanes_of_leaves(at, found, start), lambda: zero)
            return so_far.plus(more), None

        starts = jnp.arange(0, at.button.leaves, PIECE, dtype=jnp.int32)
        return jax.lax.scan(piece, zero, starts)[0].total()

    return jax.jvp(total, (moving,), (tangents[0],))


def _sum_of_all(at: PressedPair, found: TouchingLeaves) -> Lanes:
    def piece(state: tuple[Array, Lanes]) -> tuple[Array, Lanes]:
        start, so_far = state
        return start + PIECE, so_far.plus(_lanes_of_leaves(at, found, start))

    start = jnp.zeros((), jnp.int32), _zero_lanes(at)
    return jax.lax.while_loop(lambda s: s[0] < found.total, piece, start)[1].total()


def _zero_lanes(at: PressedPair) -> Lanes:
    zero = jnp.zeros(min(PIECE, at.button.leaves) * at.button.lanes, at.position.x.dtype)
    vectors = [[zero] * 3 for _ in range(2)]
    return Lanes(
        force=[zero] * 6,
        elastic=[zero] * 6,
        stiffness=[zero] * len(_ROWS),
        size=zero,
        energy=zero,
        area=zero,
        borne=[zero] * 2,
        moment=vectors,
        facets=vectors,
        most=zero,
        deepest=zero,
    )


def _lanes_of_leaves(at: PressedPair, found: TouchingLeaves, start: Array) -> Lanes:
    """The piece of leaves that begins at `start`."""
    # The last piece starts early enough to be full, and counts only leaves that no other piece has counted.
    first = jnp.minimum(start, max(at.button.leaves - PIECE, 0))
    leaf, place = (jax.lax.dynamic_slice_in_dim(x, first, min(PIECE, at.button.leaves)) for x in found[:2])
    number = first + jnp.arange(leaf.shape[0], dtype=jnp.int32)
    there = (number >= start) & (number < found.total)
    d = depths_in(at.button, at.femur, at.position, at.rotation, leaf, place, there)
    row = _wrench(at, d, d.normal)
    # All zero without contact.
    pressure, slope, stored = at.law.press(jnp.where(d.listed, d.depth, -1.0))
    borne, stiffness = d.area * pressure, d.area * slope
    force = borne - at.damping_time * stiffness * sum(at.twist[i] * r for i, r in enumerate(row))
    pressed = force > 0
    force, elastic, stiffness, stored_energy = (jnp.where(pressed, a, 0.0) for a in (force, borne, stiffness, stored))
    # Contribution of the changing projected areas, so that forces and moments are the derivatives of the energy.
    nothing = [0.0] * 3
    tilting = (*nothing, d.tilting.x, d.tilting.y, d.tilting.z)
    turning = [stored_energy * (m + t) for m, t in zip(_wrench(at, d, d.sliding), tilting, strict=True)]
    touching = d.listed & (d.depth > 0)
    lateral = jnp.zeros_like(d.depth) if d.lateral is None else d.lateral
    force_on_patella = force * d.normal + stored_energy * d.sliding
    on = (1 - lateral, lateral)
    borne_on = [share * borne for share in on]
    stiff = [stiffness * r for r in row]
    return Lanes(
        force=[r * force + t for r, t in zip(row, turning, strict=True)],
        elastic=[r * elastic + t for r, t in zip(row, turning, strict=True)],
        stiffness=[stiff[i] * row[j] for i, j in zip(_ROWS, _COLUMNS, strict=True)],
        size=force,
        energy=d.area * stored,
        area=jnp.where(touching, d.area, 0.0),
        borne=borne_on,
        moment=[[b * d.point.x, b * d.point.y, b * d.point.z] for b in borne_on],
        facets=[[share * a for a in (force_on_patella.x, force_on_patella.y, force_on_patella.z)] for share in on],
        most=pressure,
        deepest=jnp.where(touching, d.depth, 0.0),
    )


def _wrench(at: PressedPair, d: Depths, forces: Vec3) -> list[Array]:
    """Wrenches of forces at the centroids (femur axes): force in world axes, and moment about the centre of mass in
    axes of the mesh."""
    moment = (d.local + at.origin).cross(at.rotation.unapply(forces))
    direction = forces if at.world is None else at.world.apply(forces)
    return [direction.x, direction.y, direction.z, moment.x, moment.y, moment.z]
