"""How deep, at most, corners below a node of one tree can be in the triangles below a node of another.

Along its own normal a corner of a sphere is as deep as the point where its ray leaves is nearer to the sphere's middle
than the radius; a normal tilted against the sphere's makes that a little more. So a shell around a node's corners and a
disc around a node's triangles bound the depth; beside it both nodes' discs tell whether one is over the other. What
depends on one node alone is worked out before a loop.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Rotation, Vec3

ROUGH = 1e-7  # [m]: what single precision may be off by, several times over
MOST_TILT = 0.4  # of normals against a shell's from which on it bounds nothing
CANCELLED = 1e-6  # what single precision may lose where a square is taken from one as large, and room


def triangle_nodes(discs: Sequence[Array], limit: Array) -> list[Array]:
    """Rows (9): a disc (8), and how far above it corners may be that are deep by the limit [m] at most."""
    rows = []
    for disc in discs:
        radius, half = disc[:, 6], disc[:, 7]
        # Rays leave outward: corners are below, but for what triangles are inclined to their disc.
        above = half + ROUGH + limit * jnp.minimum(4 * half / radius, 1.0)
        rows.append(_single(disc, above))
    return rows


def corner_nodes(levels: Sequence[Array], limit: Array) -> list[Array]:
    """Rows (15): a disc (8), a sphere's middle (3), 1 or -1 where corners look outward or inward, p and q for which
    p - q d bounds the depth [m] at a distance d from the middle, and the sine of the most that a normal turns.
    """
    rows = []
    for level in levels:
        disc, middle = level[:, :8], level[:, 8:11]
        radius, half, tilt = level[:, 11], level[:, 12], level[:, 13]
        way = jnp.where(radius > 0, 1.0, -1.0)
        bounded = (tilt < MOST_TILT) & (jnp.abs(radius) > 2 * limit)
        stretch = jnp.where(bounded, 1 / (1 - 2 * jnp.minimum(tilt, MOST_TILT)), 0.0)
        most = jnp.where(bounded, stretch * (radius + half + ROUGH), limit)
        # Across the disc the sphere's normal turns by the disc's radius over its own.
        turn = disc[:, 6] / jnp.maximum(jnp.abs(radius) - half, 1e-6)
        sine = jnp.minimum(turn + jnp.sqrt(2 * jnp.minimum(tilt, 0.5)), 1.0)
        rows.append(_single(disc, middle, way, most, way * stretch, sine))
    return rows


def most_depth(a: Array, b: Array, rotation: Rotation, position: Vec3, limit: Array) -> Array:
    """Bounds [m] (m, n) on the depth of corners below nodes b (15, m, n) whose rays leave through what is below nodes a
    (9, m, n); -1 where there can be none.

    Args:
        a, b: of `triangle_nodes` and `corner_nodes`, a component a row.
        rotation, position: of b's frame in a's.
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
    # A ray starts within b's disc and leaves it sideways by the turn of the normals at most.
    reach = wide + b[6] + jnp.where(highest < limit, highest, limit) * sine
    aside = away.squared_norm() - along * along
    facing = normal.dot(axis)
    above = away.dot(axis) - b[7] * jnp.abs(facing) - a[8]
    below = (above <= 0) | (above * above <= b[6] * b[6] * (jnp.abs(1 - facing * facing) + CANCELLED))
    ahead = along - wide - b[7] <= limit  # not on the far side of the mesh
    return jnp.where(ahead & below & (aside <= reach * reach) & (highest >= 0), highest, -1.0)


def _single(*parts: Array) -> Array:
    columns = [p if p.ndim == 2 else p[:, None] for p in parts]
    return jnp.concatenate([c.astype(jnp.float32) for c in columns], axis=1)


def _positive(x: Array) -> Array:
    return jnp.where(x > 0, x, 0.0)
