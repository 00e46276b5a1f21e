"""Contact geometry of two meshes: the contours in which they intersect, and the indentation of one in the other.

Michaud et al. 2024, section 2.4.1, after Dopico et al. 2019: the triangles that intersect give the contact contours; a
contour gives a mean point and a normal; the corners inside give the largest indentation. A contour's normal is that of
its area vector, half the sum of p x q over its segments, in any order. A curve that ends on the rim of an open mesh is
closed along the rim.

There is one contact per facet of the groove, medial and lateral, however many curves it consists of. If a curve crosses
the border of the facets, both are one contact.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.base.leaves import filled_tangents, split_by_tangent
from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.corners import ray_depth
from pftwin.geometry.bvh.deepest import Deepest, DepthSearch, depth_search
from pftwin.geometry.bvh.loops import member_by_member, most_in_batch
from pftwin.geometry.bvh.pairs import PairListLengths, Pairs, PairSearch, pair_search
from pftwin.geometry.bvh.triangle import Segment, Triangle, crossing, select
from pftwin.geometry.contact.contact_mesh import ContactMesh

LIMIT = 5e-3  # [m] largest indentation that is searched for
FULL = 0.9  # share of the limit above which deeper corners may have been missed


class ContourContact(NamedTuple):
    """One contact, in the first mesh's frame; all zero if there is no contact."""

    point: Vec3  # mean of the contour, weighted by length [m]
    normal: Vec3  # unit, out of the first mesh
    indentation: Scalar  # [m]
    area: Scalar  # area enclosed by the contour, projected along the normal [m^2]


class Contacts(NamedTuple):
    """All contacts of two meshes at a pose."""

    each: tuple[ContourContact, ...]  # one per facet of the first mesh; if merged, the first holds both
    pairs: Array  # () int32: number of pairs of triangles that intersect
    merged: Array  # () bool: whether both facets have one common contact
    at_rim: Array  # () bool: a contour ends on the rim of an open mesh, beyond which nothing bears load
    overflow: Array  # () bool: a search exceeded its capacity, the contact may be wrong
    too_deep: Array  # () bool: corners are near the search limit, or inside although no triangles intersect


class MeshPair(eqx.Module):
    """Two meshes that may touch, with their searches; make it once, before a loop."""

    a: ContactMesh
    b: ContactMesh
    pairs: PairSearch
    depths: DepthSearch

    def contacts(self, X_AB: Pose) -> Contacts:
        """All contacts with b at a pose in a's frame. Supports jit, vmap, forward and reverse derivatives."""
        pairs = self.pairs.meeting(X_AB)
        deepest = self.depths(X_AB)
        found = contour_sums(self, X_AB, pairs)
        sums, merged = found.facets, found.across > 0
        depths = self._indentations(X_AB, deepest)
        if self.a.facets == 2:
            both = jax.tree.map(lambda x, y: x + y, *sums)
            sums = select(merged, (both, jax.tree.map(jnp.zeros_like, both)), sums)
            most = jnp.maximum(depths[0], depths[1])
            depths = [jnp.where(merged, most, depths[0]), jnp.where(merged, 0.0, depths[1])]
        each = tuple(_contact(s, d, X_AB.position) for s, d in zip(sums, depths, strict=True))
        overflow = pairs.overflow | deepest.overflow
        most = stop_gradient(jnp.max(jnp.stack(depths)))
        too_deep = (most > FULL * self.depths.limit) | (deepest.found.any() & (pairs.count == 0))
        at_rim = jnp.stack([s.rim_ends > 0 for s in sums]).any()
        return Contacts(each, pairs.count, merged, at_rim, overflow, too_deep)

    def _indentations(self, X_AB: Pose, deepest: Deepest) -> list[Scalar]:
        """Depth of each facet's deepest corner [m]; 0 if there is none."""
        t = Triangle.of_rows(self.a.tree.triangles[deepest.place])
        rotation = X_AB.orientation.rotation()
        corner = rotation.apply(Vec3.from_array(self.b.corners.points[deepest.corner])) + X_AB.position
        depth, _ = ray_depth(corner, rotation.apply(Vec3.from_array(self.b.corners.normals[deepest.corner])), t)
        depth = jnp.where(deepest.found, depth, 0.0)
        return [depth[k] for k in range(self.a.facets)]


def mesh_pair(a: ContactMesh, b: ContactMesh, *, room: PairListLengths | None = None) -> MeshPair:
    """Makes the searches of two meshes; b's corners are searched for inside a.

    `room` holds capacities of the lists of pairs; None: more than an implant and a button need.
    """
    return MeshPair(a, b, pair_search(a.tree, b.tree, room), depth_search(a, b.corners, jnp.asarray(LIMIT, float)))


def _contact(sums: SegmentSums, depth: Scalar, origin: Vec3) -> ContourContact:
    sums = _closed(sums)
    square = sums.area.squared_norm()
    there = stop_gradient((square > 0) & (sums.length > 0))
    area = jnp.where(there, jnp.sqrt(jnp.where(there, square, 1.0)), 0.0)
    over_area, over_length = (jnp.where(there, 1 / jnp.where(there, x, 1.0), 0.0) for x in (area, sums.length))
    # The segments run along (normal of a) x (normal of b): around the part of b that is inside a.
    point = jax.tree.map(lambda m, o: jnp.where(there, over_length * m + o, 0.0), sums.moment, origin)
    return ContourContact(point, over_area * sums.area, jnp.where(there, depth, 0.0), area)


def _closed(sums: SegmentSums) -> SegmentSums:
    """Closes the contour along the rim, straight from its end to its start, through the middle of all its ends.

    Taken about that middle the closing line adds no area; about b's origin it subtracts half of middle x (ends -
    starts). This is exact for one curve at a straight rim; several curves of a contact are closed through one middle.
    """
    some = stop_gradient(sums.rim_ends > 0)
    middle = jnp.where(some, 1 / jnp.where(some, sums.rim_ends, 1.0), 0.0) * sums.rim_points
    square = sums.rim_gap.squared_norm()
    open_ends = some & stop_gradient(square > 0)
    way = jnp.where(open_ends, jnp.sqrt(jnp.where(open_ends, square, 1.0)), 0.0)
    area = sums.area - 0.5 * middle.cross(sums.rim_gap)
    return sums._replace(area=area, moment=sums.moment + way * middle, length=sums.length + way)


# Sums over the segments in which the meshes intersect. Values: a loop over the pairs that were found. Derivatives by
# the pose: the same loop also gives the seven slopes of each sum, for any number of directions. Derivatives by the
# meshes' corners: a loop over the whole capacity of the list.


T = TypeVar("T")
PIECE = 32  # pairs that are processed at once


class SegmentSums(NamedTuple):
    """Sums over a contact's segments; positions are from b's origin."""

    area: Vec3  # area vector [m^2]
    moment: Vec3  # segments' midpoints times their lengths [m^2]
    length: Scalar  # [m]
    rim_points: Vec3  # of the ends on a rim [m]
    rim_gap: Vec3  # ends less starts of segments on a rim [m]
    rim_ends: Scalar  # number of starts and ends on a rim


class ContourSums(NamedTuple):
    """Sums over the segments of all pairs."""

    facets: tuple[SegmentSums, ...]  # one per facet
    across: Scalar  # number of segments that end on the border of two facets


Sloped = tuple[ContourSums, ContourSums]  # sums, and their slopes by the pose's position and quaternion, (7,) each
Piece = Callable[["MeshPair", Pose, Pairs, Array], T]  # function of the pairs from an index on


@eqx.filter_custom_jvp
def contour_sums(meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> ContourSums:
    """Sums over the segments in which pairs of triangles intersect; on a CPU batches run one element at a time."""
    return member_by_member(partial(_over_found, _sums_over_pairs))(meshes, X_AB, pairs)


@contour_sums.def_jvp
def _contour_sums_jvp(primals: Any, tangents: Any) -> tuple[ContourSums, ContourSums]:
    if jax.tree.leaves(tangents[0]):
        return _jvp_over_room(_sums_over_pairs, primals, tangents)
    sums, slopes = _sloped_sums(*primals)
    changes = jnp.stack(jax.tree.leaves(filled_tangents(primals[1], tangents[1])))
    return sums, jax.tree.map(lambda slope: slope @ changes, slopes)


@eqx.filter_custom_jvp
def _sloped_sums(meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> Sloped:
    return member_by_member(partial(_over_found, _sloped_piece))(meshes, X_AB, pairs)


@_sloped_sums.def_jvp
def _sloped_sums_jvp(primals: Any, tangents: Any) -> tuple[Sloped, Sloped]:
    return _jvp_over_room(_sloped_piece, primals, tangents)


def _over_found(of_piece: Piece[T], meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> T:
    """Sums over the pairs that were found."""

    def add(state: tuple[Array, T]) -> tuple[Array, T]:
        start, total = state
        return start + PIECE, jax.tree.map(jnp.add, total, of_piece(meshes, X_AB, pairs, start))

    start = jnp.zeros((), jnp.int32), _zero_sums(of_piece, meshes, X_AB, pairs)
    return jax.lax.while_loop(lambda s: s[0] < pairs.count, add, start)[1]


def _over_room(of_piece: Piece[T], meshes: MeshPair, X_AB: Pose, pairs: Pairs) -> T:
    """The same sums in a loop over the list's capacity, which JAX can differentiate."""
    nothing, most = _zero_sums(of_piece, meshes, X_AB, pairs), most_in_batch(pairs.count)

    def add(total: T, start: Array) -> tuple[T, None]:
        more = jax.lax.cond(start < most, lambda: of_piece(meshes, X_AB, pairs, start), lambda: nothing)
        return jax.tree.map(jnp.add, total, more), None

    return jax.lax.scan(add, nothing, jnp.arange(0, pairs.a.shape[0], PIECE, dtype=jnp.int32))[0]


def _jvp_over_room(of_piece: Piece[T], primals: Any, tangents: Any) -> tuple[T, T]:
    meshes, X_AB, pairs = primals
    changes = tuple(tangents[:2])
    moving, still = split_by_tangent((meshes, X_AB), changes)

    def sums(moving: Any) -> T:
        meshes, X_AB = eqx.combine(moving, still)
        return _over_room(of_piece, meshes, X_AB, pairs)

    return jax.jvp(sums, (moving,), (changes,))


def _zero_sums(of_piece: Piece[T], *args: Any) -> T:
    shapes = jax.eval_shape(of_piece, *args, jnp.zeros((), jnp.int32))
    return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)


def _sloped_piece(meshes: MeshPair, X_AB: Pose, pairs: Pairs, start: Array) -> Sloped:
    leaves, structure = jax.tree.flatten(X_AB)
    directions = jnp.eye(len(leaves), dtype=leaves[0].dtype)

    def along(direction: Array) -> tuple[ContourSums, ContourSums]:
        change = jax.tree.unflatten(structure, [direction[k] for k in range(len(leaves))])
        return jax.jvp(lambda X: _sums_over_pairs(meshes, X, pairs, start), (X_AB,), (change,))

    return jax.vmap(along, out_axes=(None, 0))(directions)


def _sums_over_pairs(meshes: MeshPair, X_AB: Pose, pairs: Pairs, start: Array) -> ContourSums:
    """Sums over the `PIECE` pairs from `start` on."""
    a, b = meshes.a, meshes.b
    which, other = (jax.lax.dynamic_slice_in_dim(x, start, PIECE) for x in (pairs.a, pairs.b))
    rows = jax.lax.optimization_barrier((a.tree.triangles[which].T, b.tree.triangles[other].T))
    first, second = (Triangle(*(Vec3(*r[3 * k : 3 * k + 3]) for k in range(3))) for r in rows)
    rotation, origin = X_AB.orientation.rotation(), X_AB.position
    # Relative to b's origin, for short lever arms and little rounding error.
    first = Triangle(*(p - origin for p in (first.a, first.b, first.c)))
    second = Triangle(*(rotation.apply(p) for p in (second.a, second.b, second.c)))
    segment = crossing(first, second)
    there = segment.crossing & (start + jnp.arange(PIECE, dtype=jnp.int32) < pairs.count)
    facet = a.facet(which)
    seam, rim, other_rim = (x.astype(jnp.int32) for x in (a.seam[which], a.rim[which], b.rim[other]))
    starts, ends = (
        ((rim & own) > 0) | ((other_rim & others) > 0) for own, others in (segment.start_edges, segment.end_edges)
    )
    sums = tuple(_sums(segment, there & (facet == k), starts, ends) for k in range(a.facets))
    across = there & ((seam & (segment.start_edges[0] | segment.end_edges[0])) > 0)
    return ContourSums(sums, jnp.sum(across).astype(origin.x.dtype))


def _sums(segment: Segment, there: Array, starts: Array, ends: Array) -> SegmentSums:
    """Sums over the segments of mask `there`; `starts` and `ends` mark those that start or end on a rim."""

    def total(x: Scalar, which: Array = there) -> Scalar:
        return jnp.sum(jnp.where(which, x, 0.0))

    p, q = segment.start, segment.end
    area, way = p.cross(q), q - p
    # Segments without length are masked, since the square root has no derivative there.
    square = way.squared_norm()
    long = there & (square > 0)
    length = jnp.where(long, jnp.sqrt(jnp.where(long, square, 1.0)), 0.0)
    middle = 0.5 * (p + q)
    first, last = (jax.tree.map(lambda x, w=w: total(x, w), e) for e, w in ((p, there & starts), (q, there & ends)))
    return SegmentSums(
        Vec3(*(0.5 * total(x) for x in (area.x, area.y, area.z))),
        Vec3(*(total(length * m) for m in (middle.x, middle.y, middle.z))),
        jnp.sum(length),
        first + last,
        last - first,
        total(starts.astype(p.x.dtype) + ends.astype(p.x.dtype)),
    )
