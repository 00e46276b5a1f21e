"""Finds the button's triangles inside the femur's surface, and the femur's triangle nearest to each of them.

The search descends the button's tree: the point of the femur nearest to the middle of a node's ball shows whether the
whole node is outside. For the remaining leaves of a few triangles each, the femur's tree is searched for all centroids
of a leaf together. No derivatives; batches run one element at a time (see `pftwin.geometry.bvh.walk`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import optimization_barrier
from jaxtyping import Array

from pftwin.base.spatial import Rotation, Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.walk import FAN, FAR, STACK, walk

if TYPE_CHECKING:
    from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface


class TouchingLeaves(NamedTuple):
    """Leaves of the button's tree in a list of fixed length; entries past the count are meaningless."""

    leaf: Array  # (width,) int32
    place: Array  # (width, lanes) int32: place of the femur's triangle nearest to each centroid; 0 if from a table
    total: Array  # () int32: number of leaves found, which may exceed the list's length


def touching_leaves(
    width: int, band: float, limit: float, button: PressingSurface, femur: PressedSurface, at: Vec3, rotation: Rotation
) -> TouchingLeaves:
    """See `PressedSurface.touching`; for one element of a batch. `at` is the position of the button's frame."""
    pieces, count = _pieces(button, femur, at, rotation, band, limit)

    def take(k: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        table, total = now
        leaf = pieces[k, 0]
        index = jax.lax.dynamic_index_in_dim(button.index, leaf, keepdims=False)
        points = _centroids(button, leaf, at, rotation)
        places = nearest_to_all(femur, points, pieces[k, 1])

        def look(lane: Array, wanted: Array) -> Array:
            p, place = jax.tree.map(lambda a: a[lane], points), places[lane]
            depth, rim = signed_depth(femur, p, place)
            return wanted | ((depth >= -band) & (depth <= limit) & ~rim & (index[lane] >= 0))

        wanted = jax.lax.fori_loop(jnp.int32(0), jnp.int32(button.lanes), look, jnp.zeros((), bool))
        row = jnp.concatenate([leaf[None], places])
        # The additional last row takes what is written past the end.
        table = jax.lax.dynamic_update_index_in_dim(table, row, jnp.minimum(total, width), 0)
        return table, total + wanted.astype(jnp.int32)

    start = jnp.zeros((width + 1, 1 + button.lanes), jnp.int32), jnp.int32(0)
    table, total = jax.lax.fori_loop(jnp.int32(0), count, take, start)
    return TouchingLeaves(table[:width, 0], table[:width, 1:], total)


def _pieces(
    button: PressingSurface, femur: PressedSurface, position: Vec3, rotation: Rotation, band: float, limit: float
) -> tuple[Array, Array]:
    """The button's leaves that may be in the femur, each with a near place of the femur, (leaves, 2); their number."""
    inner = jnp.int32(button.first.shape[0])

    def look(now: tuple[Array, Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array, Array]:
        stack, top, table, total, place = now
        number = stack[top - 1]
        ball = jax.lax.dynamic_index_in_dim(button.rows, number, keepdims=False).astype(position.x.dtype)
        middle, radius = position + rotation.apply(Vec3(ball[0], ball[1], ball[2])), ball[3]
        near = nearest_triangle(femur, middle, place)
        depth, rim = signed_depth(femur, middle, near.place)
        # Beyond the rim of an open mesh a node is undecided; its triangles decide.
        outside = (depth < -(radius + band)) & ~rim
        wanted = ~outside & (jnp.abs(depth) <= radius + limit)
        child = button.first[number // FAN] + number % FAN
        is_leaf = child >= inner
        row = jnp.stack([child - inner, near.place])
        table = jax.lax.dynamic_update_index_in_dim(table, row, total, 0)
        fan = child * FAN + jnp.arange(FAN, dtype=jnp.int32)
        stack = jax.lax.dynamic_update_slice_in_dim(stack, fan, top - 1, 0)
        opened = jnp.where(wanted & ~is_leaf, jnp.int32(FAN), jnp.int32(0))
        return stack, top - 1 + opened, table, total + (wanted & is_leaf).astype(jnp.int32), near.place

    zero = jnp.int32(0)
    stack = jnp.arange(STACK, dtype=jnp.int32)
    living = jnp.sum(button.rows[:FAN, 0] < FAR, dtype=jnp.int32)  # the root's unused lanes come last
    table = jnp.zeros((button.leaves + 1, 2), jnp.int32)
    _, _, table, total, _ = jax.lax.while_loop(lambda now: now[1] > 0, look, (stack, living, table, zero, zero))
    return table, total


def _centroids(button: PressingSurface, leaf: Array, position: Vec3, rotation: Rotation) -> Vec3:
    """Centroids of a leaf's triangles, one per lane, in the femur's frame."""
    rows = jax.lax.dynamic_index_in_dim(button.corners, leaf, keepdims=False)
    return optimization_barrier(position + rotation.apply(centroid(Triangle.of_rows(rows.T))))


def centroid(t: Triangle) -> Vec3:
    """Centroid of a triangle."""
    return (1 / 3) * (t.a + t.b + t.c)


class NearestDistances(NamedTuple):
    """Squared distances [m^2] to the nearest triangles, and their places; scalars, or one per lane."""

    square: Array
    place: Array


def nearest_triangle(femur: PressedSurface, p: Vec3, guess: Array) -> NearestDistances:
    """Finds the triangle nearest to a point, starting from any place `guess`; a near guess makes it faster."""

    def at_leaf(known: NearestDistances, leaf: Array) -> NearestDistances:
        lanes = jax.tree.map(lambda a: jnp.broadcast_to(a, (femur.width,)), p)
        square = closest_on_triangle(femur.leaf(leaf), lanes).square
        best = jnp.argmin(square).astype(jnp.int32)
        better = square[best] < known.square
        place = leaf * jnp.int32(femur.width) + best
        return NearestDistances(*(jnp.where(better, n, o) for n, o in zip((square[best], place), known, strict=True)))

    start = NearestDistances(closest_on_triangle(_corners_at(femur, guess), p).square, guess)
    return walk(femur.tree, p, lambda known: jnp.sqrt(known.square), at_leaf, start)


def nearest_to_all(femur: PressedSurface, points: Vec3, guess: Array) -> Array:
    """Places of the triangles nearest to points that are close together, one per lane; `guess` is any place."""
    low, high = (jax.tree.map(f, points) for f in (jnp.min, jnp.max))
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
    same = jax.tree.map(lambda a: jnp.broadcast_to(a, lanes), _corners_at(femur, guess))
    start = NearestDistances(closest_on_triangle(same, points).square, jnp.broadcast_to(guess, lanes))
    around = points - jax.tree.map(lambda a: jnp.broadcast_to(a, lanes), middle)
    radius_of_points = jnp.sqrt(jnp.max(around.squared_norm()))

    def limit(known: NearestDistances) -> Array:
        return jnp.sqrt(jnp.max(known.square)) + radius_of_points

    return walk(femur.tree, middle, limit, at_leaf, start).place


def signed_depth(femur: PressedSurface, p: Vec3, place: Array) -> tuple[Scalar, Array]:
    """Depth of a point below the triangle in a place [m], negative outside, and whether the rim is nearest.

    For single points only: for arrays XLA fuses the gathers into each of their uses, and compiles for minutes.
    """
    on = closest_on_triangle(_corners_at(femur, place), p)
    feature = 7 * femur.triangle[place] + on.feature
    outside = (p - on.point).dot(Vec3.from_array(femur.outward[feature])) > 0
    size = jnp.sqrt(on.square)
    return jnp.where(outside, -size, size), femur.rim[feature]


def _corners_at(femur: PressedSurface, place: Array) -> Triangle:
    return Triangle.of_rows(femur.corners[place])
