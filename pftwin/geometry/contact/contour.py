"""Contact of two meshes as geometry: the closed curves in which they cross, and how deep one is inside the other.

Michaud et al. 2024, section 2.4.1 (and Dopico et al. 2019, whom they follow): from the triangles that meet come the
contours of contact; from each contour an averaged point and a direction, from the corners inside the largest
indentation. A contour's direction is that of its area vector, half the sum of p x q over its segments, which needs no
order among them.

There is one contact for each facet of the groove, medial and lateral, whatever number of curves it consists of; where a
curve leads across the border of the facets, both are one contact.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.deepest import Deepest, DepthSearch, depth_search
from pftwin.geometry.bvh.pairs import PairListLengths, PairSearch, pair_search
from pftwin.geometry.bvh.rays import ray_depth
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.contact.contact_mesh import ContactMesh
from pftwin.geometry.contact.contour_sums import SegmentSums, contour_sums

LIMIT = 5e-3  # [m]: no indentation is looked for beyond it
FULL = 0.9  # share of the limit from which on there may be deeper corners


class ContourContact(NamedTuple):
    """One contact, in the frame of the first mesh; every leaf zero where there is none."""

    point: Vec3  # the contour's middle [m]
    normal: Vec3  # unit, out of the first mesh
    indentation: Scalar  # [m]
    area: Scalar  # that the contour encloses, seen along the normal [m^2]


class Contacts(NamedTuple):
    """Every contact of two meshes at a pose."""

    each: tuple[ContourContact, ...]  # one for each facet of the first mesh; where they are one, the first has it
    pairs: Array  # () int32: of triangles that meet
    merged: Array  # () bool: whether both facets' contacts are one
    at_rim: (
        Array  # () bool: a contour ends on the rim of an open mesh, so the contact leads past it: the force is wrong
    )
    overflow: Array  # () bool: a search ran out of room, the contact may be wrong
    too_deep: Array  # () bool: corners are as deep as is looked for, or deep without any triangles that meet


class MeshPair(eqx.Module):
    """Two meshes that may touch, laid out for searches: made once, before a loop."""

    a: ContactMesh
    b: ContactMesh
    pairs: PairSearch
    depths: DepthSearch

    def contacts(self, X_AB: Pose) -> Contacts:
        """All contacts with b at a pose in a's frame. Jit and vmap apply, forward and reverse derivatives."""
        pairs = self.pairs.meeting(X_AB)
        deepest = self.depths(X_AB)
        found = contour_sums(self, X_AB, pairs)
        sums, merged = found.facets, found.across > 0
        depths = self._indentations(X_AB, deepest)
        if self.a.facets == 2:
            both = jax.tree.map(lambda x, y: x + y, *sums)
            sums = _chosen(merged, both, sums[0]), _chosen(merged, _nothing(both), sums[1])
            most = jnp.maximum(depths[0], depths[1])
            depths = [jnp.where(merged, most, depths[0]), jnp.where(merged, 0.0, depths[1])]
        each = tuple(_contact(s, d, X_AB.position) for s, d in zip(sums, depths, strict=True))
        overflow = pairs.overflow | deepest.overflow
        most = stop_gradient(jnp.max(jnp.stack(depths)))
        too_deep = (most > FULL * self.depths.limit) | (deepest.found.any() & (pairs.count == 0))
        return Contacts(each, pairs.count, merged, found.at_rim > 0, overflow, too_deep)

    def _indentations(self, X_AB: Pose, deepest: Deepest) -> list[Scalar]:
        """How deep every facet's deepest corner is; 0 where there is none."""
        t = Triangle.of_rows(self.a.tree.triangles[deepest.place])
        rotation = X_AB.orientation.rotation()
        corner = rotation.apply(Vec3.from_array(self.b.corners.points[deepest.corner])) + X_AB.position
        depth, _ = ray_depth(corner, rotation.apply(Vec3.from_array(self.b.corners.normals[deepest.corner])), t)
        depth = jnp.where(deepest.found, depth, 0.0)
        return [depth[k] for k in range(self.a.facets)]


def mesh_pair(
    a: ContactMesh, b: ContactMesh, *, limit: Scalar | float = LIMIT, room: PairListLengths | None = None
) -> MeshPair:
    """The searches of two meshes, b's corners looked for inside a.

    Args:
        a, b: with trees of one kind.
        limit: no indentation is looked for beyond it [m].
        room: for lists of pairs; None: more than an implant and a button need.
    """
    return MeshPair(a, b, pair_search(a.tree, b.tree, room), depth_search(a, b.corners, jnp.asarray(limit, float)))


def _nothing(sums: SegmentSums) -> SegmentSums:
    return jax.tree.map(jnp.zeros_like, sums)


def _chosen(which: Array, one: SegmentSums, other: SegmentSums) -> SegmentSums:
    return jax.tree.map(lambda x, y: jnp.where(which, x, y), one, other)


def _contact(sums: SegmentSums, depth: Scalar, origin: Vec3) -> ContourContact:
    square = sums.area.squared_norm()
    there = stop_gradient((square > 0) & (sums.length > 0))
    area = jnp.where(there, jnp.sqrt(jnp.where(there, square, 1.0)), 0.0)
    over_area, over_length = (jnp.where(there, 1 / jnp.where(there, x, 1.0), 0.0) for x in (area, sums.length))
    # The segments run along (normal of a) x (normal of b): around what of b is inside a, seen from there.
    point = jax.tree.map(lambda m, o: jnp.where(there, over_length * m + o, 0.0), sums.moment, origin)
    return ContourContact(point, over_area * sums.area, jnp.where(there, depth, 0.0), area)
