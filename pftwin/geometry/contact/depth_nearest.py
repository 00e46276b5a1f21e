"""The femur's triangles nearest to points, one point or some that lie together at a time, and on which side those are.

Part of `pftwin.geometry.contact.depth_search`: nothing is differentiated.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh import discs
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.walk import walk
from pftwin.geometry.contact.depth_sides import PressedSurface


class NearestDistances(NamedTuple):
    """Squares of distances [m^2] to the nearest triangles and their places; scalars, or one for each lane."""

    square: Array
    place: Array


def nearest(femur: PressedSurface, p: Vec3, guess: Array) -> NearestDistances:
    """The place of the triangle nearest to a point, from one that is anywhere; the nearer, the quicker."""

    def at_leaf(known: NearestDistances, leaf: Array) -> NearestDistances:
        square = closest_on_triangle(femur.leaf(leaf), _as_lanes(p, femur)).square
        best = jnp.argmin(square).astype(jnp.int32)
        better = square[best] < known.square
        place = leaf * jnp.int32(femur.width) + best
        return NearestDistances(*(jnp.where(better, n, o) for n, o in zip((square[best], place), known, strict=True)))

    start = NearestDistances(closest_on_triangle(_one(femur, guess), p).square, guess)
    at = _single(p)
    return walk(
        femur.bounds,
        femur.rows,
        femur.first,
        lambda rows: discs.distances(rows, at)[0],
        lambda known: jnp.sqrt(known.square),
        at_leaf,
        start,
    )


def nearest_to_all(femur: PressedSurface, points: Vec3, guess: Array) -> Array:
    """The places nearest to points that lie together, one for each lane."""
    low, high = (Vec3(*(f(a) for a in (points.x, points.y, points.z))) for f in (jnp.min, jnp.max))
    middle = 0.5 * (low + high)

    def at_leaf(known: NearestDistances, number: Array) -> NearestDistances:
        rows = jax.tree.map(lambda a: a[None, :], femur.leaf(number))
        square = closest_on_triangle(rows, jax.tree.map(lambda a: a[:, None], points)).square
        best = jnp.argmin(square, axis=1).astype(jnp.int32)
        least = jnp.min(square, axis=1)
        better = least < known.square
        place = number * jnp.int32(femur.width) + best
        return NearestDistances(jnp.where(better, least, known.square), jnp.where(better, place, known.place))

    lanes = points.x.shape
    same = jax.tree.map(lambda a: jnp.broadcast_to(a, lanes), _one(femur, guess))
    start = NearestDistances(closest_on_triangle(same, points).square, jnp.broadcast_to(guess, lanes))
    at, around = _single(middle), (points - Vec3(*(jnp.broadcast_to(a, lanes) for a in _parts(middle)))).squared_norm()
    spread = jnp.sqrt(jnp.max(around))
    return walk(
        femur.bounds,
        femur.rows,
        femur.first,
        lambda rows: discs.distances(rows, at)[0],
        lambda known: jnp.sqrt(jnp.max(known.square)) + spread,
        at_leaf,
        start,
    ).place


def signed(femur: PressedSurface, p: Vec3, place: Array) -> tuple[Scalar, Array]:
    """How deep a point is below the triangle in a place [m], and whether it is nearest to the rim there.

    For single points: with lanes XLA fuses the gathers into every use of theirs, and compiles for minutes.
    """
    on = closest_on_triangle(_one(femur, place), p)
    feature = 7 * femur.triangle[place] + on.feature
    outside = (p - on.point).dot(Vec3.from_array(femur.outward[feature])) > 0
    size = jnp.sqrt(on.square)
    return jnp.where(outside, -size, size), femur.rim[feature]


def _one(femur: PressedSurface, place: Array) -> Triangle:
    return Triangle.of_rows(femur.corners[place])


def _as_lanes(p: Vec3, femur: PressedSurface) -> Vec3:
    return jax.tree.map(lambda a: jnp.broadcast_to(a, (femur.width,)), p)


def _single(p: Vec3) -> Array:
    return jnp.stack([a.astype(jnp.float32) for a in _parts(p)])


def _parts(p: Vec3) -> tuple[Scalar, Scalar, Scalar]:
    return p.x, p.y, p.z
