"""Which parts of a mesh are inside a ball, and which triangles its surface may cut.

A node of the tree that lies wholly in the ball counts as one: whoever sums over the surface takes the sum over the
node, and only triangles along the ball's rim are looked at one by one. So the price grows with the length of a
contact's outline, not with its area.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh.members import member_by_member
from pftwin.geometry.bvh.queue import written_where
from pftwin.geometry.bvh.wide import FAN, SLACK, WideTree, squares


class BallListLengths(NamedTuple):
    """How long the lists are."""

    cut: int  # triangles that the ball's surface may cut
    inside: int  # nodes wholly inside


class InBall(NamedTuple):
    """Lists of fixed length; entries past the counts mean nothing."""

    cut: Array  # (room.cut,) int32: places of the triangles that the ball's surface may cut
    n_cut: Array  # () int32, may be more than the list holds
    inside: Array  # (room.inside,) int32: numbers of the nodes wholly inside
    n_inside: Array  # () int32

    def overflow(self) -> Array:
        """Whether some were lost."""
        return (self.n_cut > self.cut.shape[0]) | (self.n_inside > self.inside.shape[0])


def in_ball(tree: WideTree, center: Vec3, radius: Scalar, room: BallListLengths) -> InBall:
    """What is inside a ball about a point of the mesh's frame [m]. Nothing here is differentiated."""
    ball = jnp.stack([jnp.asarray(a, jnp.float32) for a in (center.x, center.y, center.z, radius)])
    return member_by_member(partial(_search, room))(tree, ball)


def _search(room: BallListLengths, tree: WideTree, ball: Array) -> InBall:
    # One array for both lists, nodes inside behind those to look at: XLA copies a second one in every round.
    shelf = 2 * room.cut + 2 * FAN  # half of it for inner nodes on the way
    size = shelf + room.inside + FAN
    reach = ball[3] * ball[3]

    def look(state: tuple[Array, ...]) -> tuple[Array, ...]:
        head, lists, end, inside_end = state
        block, first = tree.below(jax.lax.dynamic_index_in_dim(lists, head, keepdims=False))
        least, most = squares(block, ball[:3])
        inside = most <= jnp.float32(1 - 2 * SLACK) * reach
        touched = least <= jnp.float32(1 + 2 * SLACK) * reach
        lists, end = written_where(lists, end, shelf - FAN, touched & ~inside, lambda lane: first + lane)
        lists, inside_end = written_where(lists, inside_end, size - FAN, inside, lambda lane: first + lane)
        return head + 1, lists, end, inside_end

    def more(state: tuple[Array, ...]) -> Array:
        head, lists, end, _ = state
        node = jax.lax.dynamic_index_in_dim(lists, head, keepdims=False)
        return (head < jnp.minimum(end, shelf - FAN)) & (node < tree.n_inner)

    zero = jnp.zeros((), jnp.int32)
    start = (zero, jnp.full(size, -1, jnp.int32), zero + 1, zero + shelf)
    head, lists, end, inside_end = jax.lax.while_loop(more, look, start)
    cut = jax.lax.dynamic_slice_in_dim(lists, head, room.cut) - tree.n_inner
    # Where inner nodes took all the room on the way, the triangles that came in first are not all there are.
    n_cut = jnp.where(end > shelf - FAN, room.cut + 1, end - head)
    kept = jnp.arange(room.cut, dtype=jnp.int32) < n_cut
    n_inside = inside_end - shelf
    listed = jnp.arange(room.inside, dtype=jnp.int32) < n_inside
    inside = jnp.where(listed, lists[shelf : shelf + room.inside], 0)
    return InBall(jnp.where(kept, cut, 0), n_cut, inside, n_inside)
