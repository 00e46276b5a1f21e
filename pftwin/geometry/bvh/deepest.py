"""Finds the corner of a mesh that is deepest inside another mesh, measured along the corner's normal.

The depth of a corner v with outward unit normal n is the t at which the ray v - t n exits the other body through one
of its triangles. The search finds the largest depth on each facet of the other mesh. It descends both trees, the first
levels breadth first, the rest depth first from the most promising pair of nodes (branch and bound: pairs that cannot
exceed the deepest ray so far are dropped), so the result is that of testing all corners against all triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Rotation, Scalar, Vec3
from pftwin.geometry.bvh.corners import ROUGH, CornerTree, may_leave, ray_depth
from pftwin.geometry.bvh.descent import Descent, descent, go_down, unpacked
from pftwin.geometry.bvh.loops import LANES, Queue, member_by_member, pushed_where, queue_of
from pftwin.geometry.bvh.tree import CANCELLED
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.contact.contact_mesh import ContactMesh

NODES = 1024  # capacity for pairs of nodes in the breadth-first steps
LAST = 3  # number of last steps, taken depth first
ABOVE = 2  # lowest levels of the triangles' tree that are skipped: a ray is tested on sixteen triangles at once


class Deepest(NamedTuple):
    """The deepest corner on each facet of the other mesh."""

    place: Array  # (facets,) int32: place, in its tree, of the triangle through which the ray exits
    corner: Array  # (facets,) int32: place of the corner in its tree
    found: Array  # (facets,) bool: whether any corner is inside
    overflow: Array  # () bool: a list was full and pairs were lost


class DepthSearch(eqx.Module):
    """The search for the deepest corners in a mesh; make it once, before a loop."""

    onto: ContactMesh  # the mesh that the corners may be inside
    corners: CornerTree  # of the other mesh
    descent: Descent
    limit: Scalar  # longer rays do not count [m]

    def __call__(self, X: Pose) -> Deepest:
        """Searches at a pose X of the corners' mesh in the frame of `onto`. Supports jit and vmap; no derivatives."""
        return member_by_member(_search)(self, X)


def depth_search(onto: ContactMesh, corners: CornerTree, limit: Scalar) -> DepthSearch:
    """Makes the search for the deepest corners inside `onto`, up to a depth `limit` [m]."""
    single = jnp.asarray(limit).astype(jnp.float32)
    discs = triangle_nodes(onto.tree.levels[: 1 + onto.tree.depth - ABOVE], single)
    return DepthSearch(onto, corners, descent(discs, corner_nodes(corners.levels, single)), limit)


class _Stack(NamedTuple):
    """Pairs of nodes still to be searched, with upper bounds on the depth of their corners."""

    pairs: Queue  # packed pair times four, plus the number of steps left
    bounds: Queue  # float32 [m]

    @property
    def count(self) -> Array:
        return self.pairs.count

    def top(self) -> tuple[Array, Array, Array, _Stack]:
        """Pops the last entry: pair, steps left, bound, and the stack without it."""
        at = jnp.maximum(self.count - 1, 0)
        entry, bound = (jax.lax.dynamic_index_in_dim(q.entries, at, 0, keepdims=False) for q in self)
        return entry >> 2, (entry & 3).astype(jnp.int32), bound, _Stack(*(q._replace(count=at) for q in self))


class _Best(NamedTuple):
    """The deepest ray so far on each facet."""

    depth: Array  # (facets,) [m], -1 if there is none
    place: Array  # (facets,) int32
    corner: Array  # (facets,) int32


def _search(search: DepthSearch, X: Pose) -> Deepest:
    descent = search.descent
    X32 = jax.tree.map(lambda x: x.astype(jnp.float32), X)
    limit = jnp.asarray(search.limit).astype(jnp.float32)
    last, room = _stack_capacity(descent)

    def bound(a: Array, b: Array) -> Array:
        return most_depth(a, b, X32.orientation.rotation(), X32.position, limit)

    ahead, lost = go_down(descent, lambda a, b: bound(a, b) >= 0, room, stop=last)
    zero = jnp.zeros((), jnp.int32)
    none = jnp.zeros(search.onto.facets, jnp.int32)
    best = _Best(jnp.full(search.onto.facets, -1.0, X.position.x.dtype), none, none)
    if not last:
        best = jax.lax.fori_loop(zero, ahead.length, lambda k, best: _ray(search, X, ahead.entries[k], best), best)
        return Deepest(best.place, best.corner, best.depth >= 0, lost)
    deep = room + LANES * last
    stack = _Stack(
        queue_of(deep, ahead.entries[:room] * 4 + last, descent.code),
        queue_of(deep, jnp.full(room, limit), jnp.float32),
    )
    stack = _Stack(*(q._replace(count=ahead.length) for q in stack))

    def is_node(state: tuple[_Stack, Array]) -> Array:
        return (state[0].count > 0) & (state[0].top()[1] > 1)

    def one_leaf(state: tuple[_Stack, _Best, Array]) -> tuple[_Stack, _Best, Array]:
        stack, best, lost = state

        def expand(inner: tuple[_Stack, Array]) -> tuple[_Stack, Array]:
            stack = _expand_top(search, bound, inner[0], best.depth)
            return stack, inner[1] | stack.pairs.overflow

        stack, lost = jax.lax.while_loop(is_node, expand, (stack, lost))
        stack, best = _rays_tried(search, X, stack, best)
        return stack, best, lost

    _, best, lost = jax.lax.while_loop(lambda s: s[0].count > 0, one_leaf, (stack, best, lost))
    return Deepest(best.place, best.corner, best.depth >= 0, lost)


def _stack_capacity(descent: Descent) -> tuple[int, int]:
    """The number of steps taken depth first, and the capacity for pairs of nodes before them.

    A mesh of a few large triangles takes only one or two steps, from all corners at once: then the capacity is that for
    all pairs.
    """
    alone, together = descent.steps
    last = min(LAST, len(together))
    if len(together) > last:
        return last, NODES
    levels = together[0].start if together else alone[-1].end if alone else descent.depths
    return last, max(NODES, 1 << sum(levels))


def _facet(search: DepthSearch, pair: Array, left: Array | int) -> Array:
    """Facet of a pair of nodes that is `left` steps above the leaves."""
    if search.onto.facets == 1:
        return jnp.zeros((), jnp.int32)
    a, b = search.descent.depths
    return (pair >> (a + b - 1 - 4 * left)).astype(jnp.int32) & 1


def _expand_top(search: DepthSearch, most: Callable[[Array, Array], Array], stack: _Stack, deepest: Array) -> _Stack:
    """Replaces the top pair of nodes by its descendants that may be deeper than the deepest ray so far."""
    pair, left, bound, stack = stack.top()
    below = search.descent.below(pair, left)
    sure = deepest[_facet(search, pair, left)].astype(jnp.float32)
    highest = most(below.a, below.b)  # (4, 4): if flattened here, XLA does not vectorize it
    yes = (highest > sure) & (bound > sure)
    code = (left - 1).astype(pair.dtype)
    pairs = pushed_where(stack.pairs, yes, lambda lane: below.pair(lane) * 4 + code)
    return _Stack(pairs, pushed_where(stack.bounds, yes, lambda lane: highest[lane >> 2, lane & 3]))


def _rays_tried(search: DepthSearch, X: Pose, stack: _Stack, best: _Best) -> tuple[_Stack, _Best]:
    """Pops the top pair and tests its rays: those that pass through a node's disc are tested on its triangles."""
    pair, left, bound, rest = stack.top()
    below = search.descent.below(pair, jnp.ones((), jnp.int32))
    sure = best.depth[_facet(search, pair, 1)].astype(jnp.float32)
    X32 = jax.tree.map(lambda x: x.astype(jnp.float32), X)
    yes = may_leave(below.a, below.b, X32, sure) & (bound > sure) & (stack.count > 0) & (left == 1)
    tried = pushed_where(queue_of(LANES, dtype=pair.dtype), yes, below.pair)
    best = jax.lax.fori_loop(
        jnp.zeros((), jnp.int32), tried.count, lambda k, best: _ray(search, X, tried.entries[k], best), best
    )
    return rest, best


def _ray(search: DepthSearch, X: Pose, pair: Array, best: _Best) -> _Best:
    """Tests the ray of a corner on the sixteen triangles of a node."""
    corners, rotation = search.corners, X.orientation.rotation()
    i, j = unpacked(pair, corners.depth)
    rows = jax.lax.dynamic_slice_in_dim(search.onto.tree.triangles, i * LANES, LANES).T
    t = Triangle(*(Vec3(*rows[3 * k : 3 * k + 3]) for k in range(3)))
    point = rotation.apply(Vec3(*corners.points[j])) + X.position
    depth, hit = ray_depth(point, rotation.apply(Vec3(*corners.normals[j])), t)
    depth = jnp.where(hit & (depth >= 0) & (depth <= search.limit), depth, -1.0)
    lane = jnp.argmax(depth).astype(jnp.int32)
    facet = _facet(search, pair, 0)
    better = depth[lane] > best.depth[facet]
    new = depth[lane], i * LANES + lane, j
    return _Best(
        *(
            jax.lax.dynamic_update_index_in_dim(old, jnp.where(better, x, old[facet]), facet, 0)
            for x, old in zip(new, best, strict=True)
        )
    )


# The depth of a sphere's corner along the sphere's normal is the radius less the distance from the sphere's middle to
# the ray's exit; a normal tilted against the sphere's adds a little. So a shell around a node's corners and a disc
# around a node's triangles bound the depth; both nodes' discs show whether one is over the other.


MOST_TILT = 0.4  # tilt of normals against a shell's normals above which the shell gives no bound


def triangle_nodes(discs: Sequence[Array], limit: Array) -> list[Array]:
    """Rows (9) per level: a disc (8), and how far above it a corner within the depth limit [m] can be [m]."""
    # Rays exit outward, so corners are below the disc, except as far as triangles are inclined to it.
    return [_single(d, d[:, 7] + ROUGH + limit * jnp.minimum(4 * d[:, 7] / d[:, 6], 1.0)) for d in discs]


def corner_nodes(levels: Sequence[Array], limit: Array) -> list[Array]:
    """Rows (15) per level: disc (8); sphere's middle (3); 1 where normals point away from the middle, else -1; p and q,
    where p - q d bounds the depth [m] of a ray that exits at a distance d from the middle; bound on the sine of the
    angle between normals and the disc's.
    """
    rows = []
    for level in levels:
        disc, middle = level[:, :8], level[:, 8:11]
        radius, half, tilt = level[:, 11], level[:, 12], level[:, 13]
        way = jnp.where(radius > 0, 1.0, -1.0)
        bounded = (tilt < MOST_TILT) & (jnp.abs(radius) > 2 * limit)
        stretch = jnp.where(bounded, 1 / (1 - 2 * jnp.minimum(tilt, MOST_TILT)), 0.0)
        most = jnp.where(bounded, stretch * (radius + half + ROUGH), limit)
        # Across the disc the sphere's normal turns by the ratio of the disc's radius to the sphere's.
        turn = disc[:, 6] / jnp.maximum(jnp.abs(radius) - half, 1e-6)
        sine = jnp.minimum(turn + jnp.sqrt(2 * jnp.minimum(tilt, 0.5)), 1.0)
        rows.append(_single(disc, middle, way, most, way * stretch, sine))
    return rows


def most_depth(a: Array, b: Array, rotation: Rotation, position: Vec3, limit: Array) -> Array:
    """Upper bounds (m, n) [m] on the depth of corners in nodes b (15, m, n) whose rays exit through triangles in nodes
    a (9, m, n); -1 if no ray can.

    Args:
        a, b: rows of `triangle_nodes` and `corner_nodes`, one component per row.
        rotation, position: pose of b's frame in a's.
        limit: longer rays do not count [m].
    """
    disc, axis, radius, half = Vec3(*a[:3]), Vec3(*a[3:6]), a[6], a[7]
    way, most, fall, sine = b[11:15]
    away = rotation.apply(Vec3(*b[8:11])) + position - disc
    height = jnp.abs(away.dot(axis))
    beside = jnp.sqrt(jnp.abs(away.squared_norm() - height * height))
    over, beyond = _positive(height - way * half), _positive(beside - way * radius)
    highest = most - fall * jnp.sqrt(over * over + beyond * beyond)

    normal = rotation.apply(Vec3(*b[3:6]))
    away = rotation.apply(Vec3(*b[:3])) + position - disc
    along, wide = away.dot(normal), radius + half
    # A ray starts within b's disc; the angle between normals bounds how far it moves sideways.
    allowed = wide + b[6] + jnp.where(highest < limit, highest, limit) * sine
    aside = away.squared_norm() - along * along
    facing = normal.dot(axis)
    above = away.dot(axis) - b[7] * jnp.abs(facing) - a[8]
    below = (above <= 0) | (above * above <= b[6] * b[6] * (jnp.abs(1 - facing * facing) + CANCELLED))
    ahead = along - wide - b[7] <= limit  # not on the far side of the mesh
    return jnp.where(ahead & below & (aside <= allowed * allowed) & (highest >= 0), highest, -1.0)


def _single(*parts: Array) -> Array:
    columns = [p if p.ndim == 2 else p[:, None] for p in parts]
    return jnp.concatenate([c.astype(jnp.float32) for c in columns], axis=1)


def _positive(x: Array) -> Array:
    return jnp.where(x > 0, x, 0.0)
