"""A tree in blocks of sixteen, for searches that take one node at a time and look at all its descendants at once.

XLA makes one function of a whole loop on a CPU: a loop over nodes, with the sixteen discs of a node's descendants in as
many lanes, tests a disc in a few nanoseconds. In a batch the members take turns (see `members`).
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.bvh.discs import CANCELLED
from pftwin.geometry.bvh.tree import MeshTree

FAN = 16  # descendants looked at together, four levels of the binary tree below
SLACK = 1e-5  # share of a distance by which single precision may be off
_NOWHERE = 1e6  # [m] where the discs lie that fill up the first block


class WideTree(eqx.Module):
    """A mesh's tree of discs down to its single triangles, as blocks.

    Nodes are numbered level by level, the `first` ones at the top; the sixteen below node i start at 16 i + first.
    Numbers from `n_inner` on are triangles', in the order of their places.
    """

    blocks: Array  # (nodes + 1, 8, 16) float32: discs' components by lanes, below nowhere (the top), node 0, node 1 ...
    first: int = eqx.field(static=True)  # nodes at the top
    n_levels: int = eqx.field(static=True)

    @property
    def n_inner(self) -> int:
        """Nodes above the triangles."""
        return self.first * (FAN ** (self.n_levels - 1) - 1) // (FAN - 1)

    def node_sums(self, values: Array) -> Array:
        """Sums of values (places, k), one row a triangle, over each node: (nodes, k), the triangles' own included."""
        rows = [values]
        for _ in range(self.n_levels - 1):
            rows.append(rows[-1].reshape(-1, FAN, values.shape[-1]).sum(axis=1))
        return jnp.concatenate(rows[::-1])

    def lateral(self) -> NDArray[np.float64]:
        """Which nodes are in the second half of the places, (nodes,), 1 or 0."""
        sizes = [self.first * FAN**k for k in range(self.n_levels)]
        return np.concatenate([(2 * np.arange(n) >= n).astype(np.float64) for n in sizes])

    def below(self, node: Array) -> tuple[Array, Array]:
        """The block (8, 16) below a node, or of the top below -1, and the number of its first lane."""
        block = jax.lax.dynamic_index_in_dim(self.blocks, node + 1, keepdims=False)
        return block, jnp.where(node < 0, 0, FAN * node + self.first)


def wide_tree(tree: MeshTree) -> WideTree:
    """The blocks of a tree. The copies that fill its empty places are found by no search.

    Raises:
        InputError: a tree of boxes, or with more than one triangle in a leaf.
    """
    if tree.kind != "disc" or tree.leaf != 1:
        raise InputError(f"{tree.kind}s with {tree.leaf} triangles a leaf", where="tree", expected="discs with one")
    top = tree.depth % 4 or min(4, tree.depth)
    levels = [np.array(tree.levels[k]) for k in range(top, tree.depth + 1, 4)]
    nowhere = np.array([_NOWHERE] * 3 + [0, 0, 1, 0, 0], np.float32)
    levels[-1][np.asarray(tree.index) < 0] = nowhere  # copies, which fill empty places
    filled = np.tile(nowhere, (FAN, 1))
    filled[: len(levels[0])] = levels[0]
    blocks = [filled[None], *(level.reshape(-1, FAN, 8) for level in levels[1:])]
    lanes = np.ascontiguousarray(np.swapaxes(np.concatenate(blocks), 1, 2))
    return WideTree(jax.device_put(lanes), len(levels[0]), len(levels))


def squares(block: Array, point: Array) -> tuple[Array, Array]:
    """Bounds (16,) on the squared distances from a point (3,) to what is in the discs (8, 16): at least, at most."""
    away = [point[i] - block[i] for i in range(3)]
    square = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
    height = jnp.abs(away[0] * block[3] + away[1] * block[4] + away[2] * block[5])
    beside, lost = square - height * height, jnp.float32(CANCELLED) * square
    nearest = jnp.maximum(jnp.sqrt(jnp.maximum(beside - lost, 0)) - block[6], 0)
    farthest = jnp.sqrt(jnp.maximum(beside, 0) + lost) + block[6]
    low, high = jnp.maximum(height - block[7], 0), height + block[7]
    return nearest * nearest + low * low, farthest * farthest + high * high
