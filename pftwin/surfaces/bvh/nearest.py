"""Which triangle of a mesh is nearest to a point.

Level by level (every `STRIDE`-th of the tree's) those nodes stay in the race whose least distance is not above the
smallest of the largest ones; all are looked at at once. Of the triangles of the leaves that are left the nearest is
taken: the brute force's answer. A list that would be longer than its fixed length is cut, and the answer says so.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array

from pftwin.spatial import Vec3
from pftwin.surfaces.bvh.compaction import compacted
from pftwin.surfaces.bvh.tree import MeshTree
from pftwin.surfaces.triangle import Triangle, closest_on_triangle

STRIDE = 4  # levels between two looks: sixteen descendants
FIRST = 512  # nodes, at most, of the level that is looked at first, all of them
WIDTH = {"disc": 64, "box": 768}  # nodes that may stay in the race: half as many again as on an implant
SLACK = 1e-5  # share of a distance by which single precision may be off


class Nearest(NamedTuple):
    """The nearest triangle."""

    place: Array  # () int32, in the tree
    overflow: Array  # () bool: more nodes were in the race than there was room for; the answer may be wrong


def looks(tree: MeshTree, top: int = 0, stride: int = STRIDE) -> list[int]:
    """The levels that are looked at, down to the leaves, in the part of a tree below a node of the level `top`."""
    first = tree.depth
    while first - stride >= top and 1 << (first - top) > FIRST:
        first -= stride
    return list(range(first, tree.depth + 1, stride))


def nearest(
    tree: MeshTree, point: Vec3, *, width: int | None = None, below: tuple[int, Array | int] = (0, 0)
) -> Nearest:
    """The triangle nearest to a point of the mesh's frame. Nothing here is differentiated.

    Jit and vmap apply; all lists have fixed lengths, so a batch costs what its members cost.

    Args:
        tree: of the mesh.
        point: in the mesh's frame [m].
        width: room for the nodes that stay in the race; None: enough for an implant.
        below: level and number of a node: of all triangles those below it.
    """
    tree, point = stop_gradient((tree, point))
    width = WIDTH[tree.kind] if width is None else width
    p = jnp.stack([jnp.asarray(a, jnp.float32) for a in (point.x, point.y, point.z)])
    levels = looks(tree, below[0])
    count = 1 << (levels[0] - below[0])
    start = jnp.asarray(below[1], jnp.int32) * count
    nodes, overflow = start + jnp.arange(count, dtype=jnp.int32), jnp.asarray(False)
    rows = jax.lax.dynamic_slice_in_dim(tree.levels[levels[0]], start, count)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        least, most = tree.volumes.distances(rows, p)
        kept = compacted(least <= jnp.min(most) * (1 + SLACK), min(width, nodes.shape[0]))
        overflow = overflow | kept.overflow()
        nodes = jnp.where(kept.valid(), nodes[kept.index], nodes[kept.index[0]])
        if following is not None:
            nodes, rows = _below(tree, nodes, level, following)
    return Nearest(_among(tree, point, nodes), overflow)


def _below(tree: MeshTree, nodes: Array, level: int, following: int) -> tuple[Array, Array]:
    """The descendants of some nodes at a level below, and their bounding volumes."""
    many = 1 << (following - level)
    blocks = tree.levels[following].reshape(1 << level, many, -1)
    children = nodes[:, None] * many + jnp.arange(many, dtype=jnp.int32)[None, :]
    return children.reshape(-1), blocks[nodes].reshape(nodes.shape[0] * many, -1)


def _among(tree: MeshTree, point: Vec3, leaves: Array) -> Array:
    """The place of the nearest triangle in some leaves."""
    rows = tree.triangles.reshape(1 << tree.depth, tree.leaf, 9)[leaves].reshape(-1, 9)
    p = Vec3(*(jnp.broadcast_to(a, rows.shape[:1]) for a in (point.x, point.y, point.z)))
    best = jnp.argmin(closest_on_triangle(Triangle.of_rows(rows), p).square).astype(jnp.int32)
    return leaves[best // tree.leaf] * tree.leaf + best % tree.leaf
