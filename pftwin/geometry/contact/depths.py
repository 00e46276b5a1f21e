"""Depths of the triangles of one mesh in another, as a differentiable list of fixed length.

A triangle's depth is the distance of its centroid from the nearest point of the other surface, positive inside. A
centroid whose nearest point is on the rim of an open surface is neither inside nor outside and has no depth. The
triangles are selected without derivatives (`pftwin.geometry.contact.depth_search`); their depths are then computed with
derivatives with respect to the pose and to both meshes' vertices.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.base.spatial import Rotation, Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.contact.depth_search import centroid
from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface, gathered
from pftwin.geometry.contact.distance_grid import DistanceGrid

MAX_DEPTH = 0.010  # [m] largest depth of the search
DEEPEST = 0.005  # [m] larger depths are implausible and point to a wrong pose, scale or side


class Depths(NamedTuple):
    """Depths of some of the button's triangles, (width,) each; vectors in the femur's frame unless stated."""

    depth: Scalar  # [m], positive inside; valid where listed
    listed: Array  # bool: whether the entry is valid
    triangle: Array  # int32: index in the button's mesh, or of the group if triangles are merged
    point: Vec3  # the triangle's centroid [m]
    local: Vec3  # the centroid in the button's frame [m]
    normal: Vec3  # unit, out of the femur: minus the depth's gradient with respect to the point
    area: Scalar  # of the triangle, projected along the normal [m^2]
    tilting: Vec3  # minus the area's derivative by the button's rotation, in the button's frame [m^2/rad]
    sliding: Vec3  # minus its derivative by the centroid's position; zero if normals are constant on faces [m]
    lateral: Scalar | None  # share of the triangle on the lateral facet, 0 to 1; None if there are no facets


def depths(
    button: PressingSurface,
    femur: PressedSurface | DistanceGrid,
    position: Vec3,
    rotation: Rotation,
    *,
    band: float = 0.0,
) -> Depths:
    """Depths of those triangles of the button that are in or near the femur. Supports jit, vmap and grad.

    The list has room for all triangles, so none is ever lost.

    Args:
        button, femur: the surfaces.
        position, rotation: of the button's frame in the femur's.
        band: distance outside up to which triangles are listed too [m].
    """
    found = femur.touching(button, position, rotation, width=button.leaves, band=band, limit=MAX_DEPTH)
    there = jnp.arange(button.leaves, dtype=jnp.int32) < found.total
    return depths_in(button, femur, position, rotation, found.leaf, found.place, there, band=band)


def depths_in(
    button: PressingSurface,
    femur: PressedSurface | DistanceGrid,
    position: Vec3,
    rotation: Rotation,
    leaf: Array,
    place: Array,
    there: Array,
    *,
    band: float = 0.0,
) -> Depths:
    """Depths of the triangles in some leaves of the button, (leaves * lanes,).

    Args:
        button, femur, position, rotation, band: as for `depths`.
        leaf: the leaves, (leaves,) int32.
        place: nearest places, (leaves, lanes) int32, from `pftwin.geometry.contact.depth_search`.
        there: whether a leaf is valid, (leaves,) bool.
    """
    # Every value is an array over the triangles, so that XLA computes several triangles with one instruction.
    rows, index = gathered((button.corners[leaf], button.index[leaf].reshape(-1)))
    own = Triangle.of_rows(jnp.moveaxis(rows, 1, -1).reshape(-1, 9))
    local, vector = centroid(own), own.area_vector()
    point = position + rotation.apply(local)
    depth, normal, bend, rim, lateral = femur.below(place.reshape(-1), point, rotation.apply(vector))
    along = rotation.unapply(normal)
    projected = 0.5 * vector.dot(along)
    facing = jnp.where(stop_gradient(projected) < 0, -1.0, 1.0)  # independent of the mesh's orientation
    inside = (stop_gradient(depth) >= -band) & (stop_gradient(depth) <= MAX_DEPTH) & ~rim
    return Depths(
        depth=depth,
        listed=inside & (index >= 0) & jnp.repeat(there, button.lanes),
        triangle=jnp.where(index < 0, -1 - index, index),
        point=point,
        local=local,
        normal=normal,
        area=facing * projected,
        tilting=(0.5 * facing) * along.cross(vector),
        sliding=(-0.5 * facing) * bend,
        lateral=None if lateral is None else _share(lateral, vector),
    )


def _share(lateral: Scalar, vector: Vec3) -> Scalar:
    """Shares of triangles beyond a straight border: each as if it were a square across it, of the same area."""
    width = jnp.sqrt(jnp.maximum(0.5 * vector.norm(), 1e-30))
    return jnp.clip(0.5 + lateral / width, 0.0, 1.0)
