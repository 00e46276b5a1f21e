"""A triangle mesh with its bounding volume hierarchy, as a pytree; and how it is built.

The tree is complete: level l has 2^l nodes, the children of node i are 2 i and 2 i + 1 of the next level, and the
triangles of the leaf i are in the places from i * leaf on. Bounding volumes are single precision and hold their
triangles with room for its rounding; triangles are in JAX's default float type.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.base.text_files import MESH_TRIANGLES
from pftwin.geometry.bvh import boxes, discs
from pftwin.geometry.bvh.order import depth_for, median_order
from pftwin.geometry.mesh.mesh import SurfaceMesh

Kind = Literal["disc", "box"]
VOLUMES: dict[str, ModuleType] = {"disc": discs, "box": boxes}
ROUNDING = 32 * float(
    np.finfo(np.float32).eps
)  # of the largest coordinate: what queries in single precision may be off


class MeshTree(eqx.Module):
    """A mesh and its tree. Arrays are leaves: a moved or another mesh of the same size re-uses the compiled program."""

    triangles: Array  # (places, 9) corners a, b, c [m]
    index: (
        Array  # (places,) int32: which triangle of the mesh; in an empty place, which holds a copy, -1 - its original
    )
    levels: tuple[Array, ...]  # (2^l, width) float32 bounding volumes, the root first
    kind: Kind = eqx.field(static=True, default="disc")

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return len(self.levels) - 1

    @property
    def leaf(self) -> int:
        """Places in a leaf."""
        return self.index.shape[-1] >> self.depth

    @property
    def volumes(self) -> ModuleType:
        """The kind of bounding volume: `boxes` or `discs`."""
        return VOLUMES[self.kind]

    def source_index(self) -> Array:
        """Which triangle of the mesh is in each place, copies included, (places,)."""
        return jnp.where(self.index < 0, -1 - self.index, self.index)


def build_tree(mesh: SurfaceMesh, *, kind: Kind = "disc", leaf: int = 4, depth: int | None = None) -> MeshTree:
    """The tree of a mesh; found again, not built, where values are kept and one of the same content was built before.

    Args:
        mesh: open or closed [m].
        kind: "disc", or "box" as the paper has them.
        leaf: most triangles in a leaf.
        depth: levels below the root, if more than the mesh needs.

    Raises:
        InputError: an unknown kind; a leaf of no triangles; a mesh with none, with too many, or not finite.
    """
    if kind not in VOLUMES:
        raise InputError(f"no bounding volume {kind!r}", where="kind", expected='"disc" or "box"')
    if not 1 <= leaf <= 64:
        raise InputError(f"leaves of {leaf} triangles", where="leaf", expected="1 to 64")
    if not 0 < len(mesh.faces) <= MESH_TRIANGLES:
        raise InputError(f"{len(mesh.faces)} triangles", where=mesh.source, expected=f"1 to {MESH_TRIANGLES}")
    if not np.isfinite(mesh.vertices).all():
        raise InputError("vertices that are not finite", where=mesh.source, remedy="pftwin doctor-mesh")
    deep = depth_for(len(mesh.faces), leaf)
    if depth is not None and depth < deep:
        raise InputError(f"a depth of {depth}", where="depth", expected=f"{deep} or more for this mesh")
    corners = np.ascontiguousarray(mesh.vertices[mesh.faces])
    triangles, index, levels = cached(tree_arrays, corners, kind, leaf, deep if depth is None else depth, files=())
    own = triangles.astype(canonicalize_dtype(float))
    return MeshTree(jax.device_put(own), jax.device_put(index), tuple(jax.device_put(a) for a in levels), kind)


def joined(trees: Sequence[MeshTree]) -> MeshTree:
    """One tree with two of the same depth, kind and leaf below its root; or the only one as it is.

    The triangles of the second tree come after those of the first; `index` stays each tree's own.
    """
    if len(trees) == 1:
        return trees[0]
    first, second = trees
    below = [np.concatenate([a, b]) for a, b in zip(first.levels, second.levels, strict=True)]
    triangles, index = (np.concatenate([getattr(t, n) for t in trees]) for n in ("triangles", "index"))
    root = _volumes(triangles.astype(np.float64).reshape(-1, 3, 3), first.kind, 0)
    levels = tuple(jax.device_put(a) for a in (root, *below))
    return MeshTree(jax.device_put(triangles), jax.device_put(index), levels, first.kind)


def tree_arrays(
    corners: NDArray[np.float64], kind: str, leaf: int, depth: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], tuple[NDArray[np.float32], ...]]:
    """A tree's triangles, index and levels from corners (n, 3, 3)."""
    index = median_order(corners.mean(axis=1), leaf, depth)
    placed = index.reshape(-1, leaf)
    # A leaf without any triangle (a tree deeper than it needs to be) repeats the one before it.
    full = np.maximum.accumulate(np.where(placed[:, 0] >= 0, np.arange(len(placed)), 0))
    places = np.where(placed >= 0, placed, placed[full, :1])
    triangles = corners[places.ravel()]
    index = np.where(placed >= 0, placed, -1 - places).ravel()
    return triangles.reshape(-1, 9), index.astype(np.int32), volume_levels(triangles, kind, depth)


def volume_levels(triangles: NDArray[np.float64], kind: str, depth: int) -> tuple[NDArray[np.float32], ...]:
    """The bounding volumes of every level of a tree, (2^l, width), around its triangles (places, 3, 3)."""
    return tuple(_volumes(triangles, kind, level) for level in range(depth + 1))


def _volumes(triangles: NDArray[np.float64], kind: str, level: int) -> NDArray[np.float32]:
    """The bounding volumes (2^level, width) of a tree's triangles (places, 3, 3)."""
    margin = ROUNDING * float(np.abs(triangles).max())
    vectors = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return VOLUMES[kind].fit(triangles.reshape(2**level, -1, 3), vectors.reshape(2**level, -1, 3), margin)
