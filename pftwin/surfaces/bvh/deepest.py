"""The deepest corner of a mesh inside another: how far it is, along its own normal, below the other's surface.

From a corner v of one mesh, with outward unit normal n there, a ray v - t n leaves the other body through one of its
triangles at t: its depth. The largest is looked for on every facet of the other mesh. Both trees are gone down, some
levels with all pairs of nodes, the rest depth first from the most promising pair; pairs that cannot be deeper than the
deepest ray found so far are dropped. So the answer is that of all corners against all triangles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.spatial import Pose, Rotation, Scalar, Vec3
from pftwin.surfaces.bvh.corners import CornerTree
from pftwin.surfaces.bvh.descent import Descent, descent, go_down, unpacked
from pftwin.surfaces.bvh.members import member_by_member
from pftwin.surfaces.bvh.queue import LANES, Queue, pushed_where, queue_of
from pftwin.surfaces.contact_mesh import ContactMesh
from pftwin.surfaces.triangle import Triangle

NODES = 1024  # pairs of nodes that there is room for
LAST = 3  # steps that are gone depth first
ABOVE = 2  # levels of the triangles' tree that are left out: rays are tried on sixteen triangles at once
ROUGH = 1e-7  # [m]: what single precision may be off by, several times over
EDGE = 1e-12  # share of a triangle by which a ray may miss its edge and still count


class Deepest(NamedTuple):
    """The deepest corner on each facet of the other mesh."""

    place: Array  # (facets,) int32: in its tree, of the triangle that the ray leaves through
    corner: Array  # (facets,) int32: the corner's place in its tree
    found: Array  # (facets,) bool: whether there is any
    overflow: Array  # () bool: pairs were lost


class DepthSearch(eqx.Module):
    """A mesh and another's corners, laid out for searches: made once, before a loop."""

    onto: ContactMesh
    corners: CornerTree
    way: Descent
    limit: Scalar  # rays longer than this do not count [m]

    def __call__(self, X: Pose) -> Deepest:
        """With the corners' mesh at a pose in the frame of `onto`. Jit and vmap apply; not differentiated."""
        return member_by_member(_search)(self, X)


def depth_search(onto: ContactMesh, corners: CornerTree, limit: Scalar) -> DepthSearch:
    """The search for the corners that are deepest inside `onto`, up to a depth [m]."""
    return DepthSearch(onto, corners, descent(onto.discs[: 1 + onto.tree.depth - ABOVE], corners.levels), limit)


def ray_depth(corner: Vec3, normal: Vec3, t: Triangle) -> tuple[Scalar, Array]:
    """How far from a corner, against its normal, a ray leaves through a triangle; and whether it does (bool)."""
    across = t.area_vector()
    steep = -normal.dot(across)
    leaves = steep > 0
    depth = (t.a - corner).dot(across) / jnp.where(leaves, steep, 1)
    # Signed volumes: the ray passes all edges on the same side.
    a, b, c = t.a - corner, t.b - corner, t.c - corner
    sides = [normal.dot(q.cross(p)) for p, q in ((a, b), (b, c), (c, a))]
    least = -EDGE * steep
    return depth, leaves & (sides[0] >= least) & (sides[1] >= least) & (sides[2] >= least)


class _Stack(NamedTuple):
    """Pairs of nodes yet to be looked at, and how deep a corner in them can be."""

    pairs: Queue  # pair times four, plus the number of steps that are left
    bounds: Queue  # float32 [m]

    @property
    def count(self) -> Array:
        return self.pairs.count

    def top(self) -> tuple[Array, Array, Array, _Stack]:
        """Pair, steps left and bound of the last entry, and the stack without it."""
        at = jnp.maximum(self.count - 1, 0)
        entry, bound = (jax.lax.dynamic_index_in_dim(q.entries, at, 0, keepdims=False) for q in self)
        return entry >> 2, (entry & 3).astype(jnp.int32), bound, _Stack(*(q._replace(count=at) for q in self))


class _Best(NamedTuple):
    """The deepest ray of every facet so far."""

    depth: Array  # (facets,) -1 where there is none [m]
    place: Array  # (facets,) int32
    corner: Array  # (facets,) int32


def _search(search: DepthSearch, X: Pose) -> Deepest:
    way = search.way
    X32 = jax.tree.map(lambda x: x.astype(jnp.float32), X)
    limit = jnp.asarray(search.limit).astype(jnp.float32)
    last = min(LAST, len(way.steps[1]))

    def bounds(a: Array, b: Array) -> tuple[Array, Array, Array]:
        return _between(a, b, X32.orientation.rotation(), X32.position, limit)

    ahead, lost = go_down(way, lambda a, b: bounds(a, b)[2], NODES, stop=last)
    zero = jnp.zeros((), jnp.int32)
    none = jnp.zeros(search.onto.facets, jnp.int32)
    best = _Best(jnp.full(search.onto.facets, -1.0, X.position.x.dtype), none, none)
    if not last:
        best = jax.lax.fori_loop(zero, ahead.length, lambda k, best: _ray(search, X, ahead.entries[k], best), best)
        return Deepest(best.place, best.corner, best.depth >= 0, lost)
    room = NODES + LANES * last
    stack = _Stack(
        queue_of(room, ahead.entries[:NODES] * 4 + last, way.code), queue_of(room, jnp.full(NODES, limit), jnp.float32)
    )
    stack = _Stack(*(q._replace(count=ahead.length) for q in stack))

    def is_node(state: tuple[_Stack, Array]) -> Array:
        return (state[0].count > 0) & (state[0].top()[1] > 1)

    def one_leaf(state: tuple[_Stack, _Best, Array]) -> tuple[_Stack, _Best, Array]:
        stack, best, lost = state

        def expand(inner: tuple[_Stack, Array]) -> tuple[_Stack, Array]:
            stack = _expanded(search, bounds, inner[0], best.depth)
            return stack, inner[1] | stack.pairs.overflow

        stack, lost = jax.lax.while_loop(is_node, expand, (stack, lost))
        stack, best = _rays_tried(search, X, stack, best)
        return stack, best, lost

    _, best, lost = jax.lax.while_loop(lambda s: s[0].count > 0, one_leaf, (stack, best, lost))
    return Deepest(best.place, best.corner, best.depth >= 0, lost)


def _facet(search: DepthSearch, pair: Array, left: Array | int) -> Array:
    """The facet of a pair of nodes, so many steps above the leaves."""
    if search.onto.facets == 1:
        return jnp.zeros((), jnp.int32)
    a, b = search.way.depths
    return (pair >> (a + b - 1 - 4 * left)).astype(jnp.int32) & 1


def _expanded(search: DepthSearch, bounds: Any, stack: _Stack, deepest: Array) -> _Stack:
    """The top pair of nodes replaced by those of its descendants that may be deeper than the deepest ray so far."""
    pair, left, bound, stack = stack.top()
    below = search.way.below(pair, left)
    sure = deepest[_facet(search, pair, left)].astype(jnp.float32)
    _, highest, possible = bounds(below.a, below.b)
    yes = possible & (highest > sure) & (bound > sure)
    highest = highest.reshape(LANES)
    code = (left - 1).astype(pair.dtype)
    pairs = pushed_where(stack.pairs, yes, lambda lane: below.pair(lane) * 4 + code)
    return _Stack(pairs, pushed_where(stack.bounds, yes, lambda lane: highest[lane]))


def _rays_tried(search: DepthSearch, X: Pose, stack: _Stack, best: _Best) -> tuple[_Stack, _Best]:
    """The top pair's rays: those that pass through a node's disc are tried on its triangles."""
    pair, left, bound, rest = stack.top()
    below = search.way.below(pair, jnp.ones((), jnp.int32))
    a, b = below.a, below.b
    sure = best.depth[_facet(search, pair, 1)].astype(jnp.float32)
    X32 = jax.tree.map(lambda x: x.astype(jnp.float32), X)
    # A single corner's disc has it as its middle, and its normal.
    point, normal = X32.apply(Vec3(*b[:3])), X32.orientation.rotate(Vec3(*b[3:6]))
    away, axis = point - Vec3(*a[:3]), Vec3(*a[3:6])
    slope = -normal.dot(axis)
    steep = slope > 0.1
    over = 1 / jnp.where(steep, slope, 1.0)
    middle, half = -away.dot(axis) * over, (a[7] + ROUGH) * over + ROUGH
    beside = (away - middle * normal).squared_norm()
    reach = a[6] + half + ROUGH
    passes = (middle + half > jnp.maximum(sure, 0)) & (beside <= reach * reach)
    # Against a thin disc's normal no ray leaves; a thick one's triangles may look anywhere.
    back = (slope < -0.1) & (a[7] < 0.1 * a[6])
    yes = jnp.where(steep, passes, ~back) & (bound > sure) & (stack.count > 0) & (left == 1)
    tried = pushed_where(queue_of(LANES, dtype=pair.dtype), yes, below.pair)
    best = jax.lax.fori_loop(
        jnp.zeros((), jnp.int32), tried.count, lambda k, best: _ray(search, X, tried.entries[k], best), best
    )
    return rest, best


def _ray(search: DepthSearch, X: Pose, pair: Array, best: _Best) -> _Best:
    """The ray of a corner through the sixteen triangles of a node."""
    i, j = unpacked(pair, search.corners.depth)
    rows = jax.lax.dynamic_slice_in_dim(search.onto.tree.triangles, i * LANES, LANES).T
    t = Triangle(*(Vec3(*rows[3 * k : 3 * k + 3]) for k in range(3)))
    rotation = X.orientation.rotation()
    point = rotation.apply(Vec3(*search.corners.points[j])) + X.position
    depth, hit = ray_depth(point, rotation.apply(Vec3(*search.corners.normals[j])), t)
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


def _between(a: Array, b: Array, rotation: Rotation, position: Vec3, limit: Array) -> tuple[Array, Array, Array]:
    """Bounds on the depth of b's corners whose rays leave through a, at least and at most; whether there may be any.

    From a's disc and b's shell: along its own normal a corner of a sphere is as deep as the leaving point is nearer to
    the sphere's middle than the radius; a normal tilted against the sphere's makes that a little more. Beside it b's
    disc tells whether one is over the other.
    """
    disc, axis, radius, half, tilt = Vec3(*a[:3]), Vec3(*a[3:6]), b[11], b[12], b[13]
    away = rotation.apply(Vec3(*b[8:11])) + position - disc
    height = jnp.abs(away.dot(axis))
    beside = jnp.sqrt(jnp.maximum(away.squared_norm() - height * height, 0))
    near = _hypotenuse(jnp.maximum(height - a[7], 0), jnp.maximum(beside - a[6], 0))
    far = _hypotenuse(height + a[7], beside + a[6])
    outward = radius > 0
    lowest = jnp.where(outward, radius - far, near + radius) - half - ROUGH
    highest = jnp.where(outward, radius - near, far + radius) + half + ROUGH
    bounded = (tilt < 0.4) & (jnp.abs(radius) > 2 * limit)
    highest = jnp.where(bounded, highest / (1 - 2 * jnp.minimum(tilt, 0.4)), limit)
    normal = rotation.apply(Vec3(*b[3:6]))
    away = rotation.apply(Vec3(*b[:3])) + position - disc
    along = away.dot(normal)
    # A ray starts within b's disc and leaves it sideways by the turn of the normals at most, which the disc's own
    # tilt against the shell bounds.
    reach = a[6] + a[7] + b[6] + jnp.clip(highest, 0, limit) * _sine(b)
    aside = away.squared_norm() - along * along
    ahead = along - a[6] - a[7] - b[7] <= limit  # not on the far side of the mesh
    # Rays leave outward: corners are below a, but for what its triangles are inclined to its disc.
    facing = normal.dot(axis)
    lower = away.dot(axis) - b[6] * jnp.sqrt(jnp.maximum(1 - facing * facing, 0) + 1e-6) - b[7] * jnp.abs(facing)
    below = lower <= a[7] + ROUGH + limit * jnp.minimum(4 * a[7] / a[6], 1.0)
    there = ahead & below & (aside <= reach * reach) & (highest >= 0) & (lowest <= limit)
    return lowest, highest, there


def _hypotenuse(x: Array, y: Array) -> Array:
    return jnp.sqrt(x * x + y * y)


def _sine(b: Array) -> Array:
    """At most the sine of the angle between a corner's normal and its disc's."""
    # Across the disc the sphere's normal turns by the disc's radius over its own.
    turn = b[6] / jnp.maximum(jnp.abs(b[11]) - b[12], 1e-6)
    return jnp.minimum(turn + jnp.sqrt(2 * jnp.minimum(b[13], 0.5)), 1.0)
