"""Sums over the segments in which two meshes cross: what the contours of contact are made from, and its derivatives.

Without derivatives only as many pairs of triangles are gone through as there are. By the pose each sum has seven
slopes, which come out of the same loop, however many directions are asked for, forward or in reverse. By the meshes'
own corners all pairs that there is room for are gone through.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.leaves import all_changes
from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.members import member_by_member
from pftwin.geometry.bvh.pairs import Pairs
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.bvh.triangle_pairs import crossing

if TYPE_CHECKING:
    from pftwin.geometry.contact.contour import MeshPair

T = TypeVar("T")
PIECE = 32  # pairs that are worked on at once


class SegmentSums(NamedTuple):
    """Over a contact's segments."""

    area: Vec3  # area vector [m^2]
    moment: Vec3  # of the segments' middles from b's origin, times their lengths [m^2]
    length: Scalar  # [m]


class ContourSums(NamedTuple):
    """Over the segments of all pairs."""

    facets: tuple[SegmentSums, ...]
    across: Scalar  # how many segments end on the border of two facets
    at_rim: Scalar  # and on a rim


class Sloped(NamedTuple):
    """Sums and their slopes."""

    sums: ContourSums
    slopes: ContourSums  # by the pose's position and quaternion: (7,) each


Piece = Callable[["MeshPair", Pose, Pairs, Array], T]  # of the pairs from a place on


@eqx.filter_custom_jvp
def contour_sums(meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> ContourSums:
    """Sums over the segments in which pairs of triangles cross; in a batch one member after the other."""
    return member_by_member(partial(_over_found, _piece))(meshes, X_AB, pairs)


@contour_sums.def_jvp
def _contour_sums_jvp(primals: Any, tangents: Any) -> tuple[ContourSums, ContourSums]:
    if jax.tree.leaves(tangents[0]):
        return _jvp_over_room(_piece, primals, tangents)
    sums, slopes = _sloped_sums(*primals)
    changes = jnp.stack(jax.tree.leaves(all_changes(primals[1], tangents[1])))
    return sums, jax.tree.map(lambda slope: slope @ changes, slopes)


@eqx.filter_custom_jvp
def _sloped_sums(meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> Sloped:
    return member_by_member(partial(_over_found, _sloped_piece))(meshes, X_AB, pairs)


@_sloped_sums.def_jvp
def _sloped_sums_jvp(primals: Any, tangents: Any) -> tuple[Sloped, Sloped]:
    return _jvp_over_room(_sloped_piece, primals, tangents)


def _over_found(of_piece: Piece[T], meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> T:
    """Over as many pairs as there are."""

    def add(state: tuple[Array, T]) -> tuple[Array, T]:
        start, total = state
        return start + PIECE, jax.tree.map(jnp.add, total, of_piece(meshes, X_AB, pairs, start))

    start = jnp.zeros((), jnp.int32), _nothing(of_piece, meshes, X_AB, pairs)
    return jax.lax.while_loop(lambda s: s[0] < pairs.count, add, start)[1]


def _over_room(of_piece: Piece[T], meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> T:
    """The same over all that there is room for, for JAX to differentiate."""
    nothing = _nothing(of_piece, meshes, X_AB, pairs)

    def add(total: T, start: Array) -> tuple[T, None]:
        more = jax.lax.cond(start < pairs.count, lambda: of_piece(meshes, X_AB, pairs, start), lambda: nothing)
        return jax.tree.map(jnp.add, total, more), None

    return jax.lax.scan(add, nothing, jnp.arange(0, pairs.a.shape[0], PIECE, dtype=jnp.int32))[0]


def _jvp_over_room(of_piece: Piece[T], primals: Any, tangents: Any) -> tuple[T, T]:
    meshes, X_AB, pairs = primals
    moving, still = eqx.partition((meshes, X_AB), eqx.is_inexact_array)
    changes = all_changes(moving, tuple(tangents[:2]))

    def sums(moving: Any) -> T:
        meshes, X_AB = eqx.combine(moving, still)
        return _over_room(of_piece, meshes, X_AB, pairs)

    return jax.jvp(sums, (moving,), (changes,))


def _nothing(of_piece: Piece[T], *args: Any) -> T:
    shapes = jax.eval_shape(of_piece, *args, jnp.zeros((), jnp.int32))
    return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)


def _sloped_piece(meshes: MeshPair, X_AB: Pose, pairs: Pairs, start: Array) -> Sloped:
    leaves, structure = jax.tree.flatten(X_AB)
    directions = jnp.eye(len(leaves), dtype=leaves[0].dtype)

    def along(direction: Array) -> tuple[ContourSums, ContourSums]:
        change = jax.tree.unflatten(structure, [direction[k] for k in range(len(leaves))])
        return jax.jvp(lambda X: _piece(meshes, X, pairs, start), (X_AB,), (change,))

    return Sloped(*jax.vmap(along, out_axes=(None, 0))(directions))


def _piece(meshes: MeshPair, X_AB: Pose, pairs: Pairs, start: Array) -> ContourSums:
    """Sums over some of the pairs."""
    a, b = meshes.a, meshes.b
    which, other = (jax.lax.dynamic_slice_in_dim(x, start, PIECE) for x in (pairs.a, pairs.b))
    rows = jax.lax.optimization_barrier((a.tree.triangles[which].T, b.tree.triangles[other].T))
    first, second = (Triangle(*(Vec3(*r[3 * k : 3 * k + 3]) for k in range(3))) for r in rows)
    rotation, origin = X_AB.orientation.rotation(), X_AB.position
    # From b's origin: short arms, little rounding.
    first = Triangle(*(p - origin for p in (first.a, first.b, first.c)))
    second = Triangle(*(rotation.apply(p) for p in (second.a, second.b, second.c)))
    segment = crossing(first, second)
    there = segment.crossing & (start + jnp.arange(PIECE, dtype=jnp.int32) < pairs.count)
    facet = a.facet(which)
    sums = tuple(_sums(segment.start, segment.end, there & (facet == k)) for k in range(a.facets))
    seam, rim, other_rim = (x.astype(jnp.int32) for x in (a.seam[which], a.rim[which], b.rim[other]))
    own, others = segment.edges
    across = there & ((seam & own) > 0)
    at_rim = there & (((rim & own) > 0) | ((other_rim & others) > 0))
    return ContourSums(sums, *(jnp.sum(x).astype(origin.x.dtype) for x in (across, at_rim)))


def _sums(p: Vec3, q: Vec3, there: Array) -> SegmentSums:
    def total(x: Scalar) -> Scalar:
        return jnp.sum(jnp.where(there, x, 0.0))

    area, way = p.cross(q), q - p
    # Safe where a segment has no length: neither it nor its derivative counts.
    square = way.squared_norm()
    long = there & (square > 0)
    length = jnp.where(long, jnp.sqrt(jnp.where(long, square, 1.0)), 0.0)
    middle = 0.5 * (p + q)
    return SegmentSums(
        Vec3(*(0.5 * total(x) for x in (area.x, area.y, area.z))),
        Vec3(*(total(length * m) for m in (middle.x, middle.y, middle.z))),
        jnp.sum(length),
    )
