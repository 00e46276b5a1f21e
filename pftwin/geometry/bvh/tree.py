"""A triangle mesh with its bounding volume hierarchy of discs, as a pytree, and the functions that build it.

The tree is a complete binary tree: level l has 2^l nodes, the children of node i are nodes 2 i and 2 i + 1 of the next
level. A "place" is a slot for a triangle; leaf i has the places from i * leaf on. A split halves a node's triangles, to
within one, along the axis in which their centroids extend farthest. So a node's triangles, and its descendants at any
level, are contiguous in memory. Discs are single precision and contain their triangles with a margin for rounding;
triangles have JAX's default float type.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.base.spatial import Rotation, Vec3
from pftwin.base.text_files import MESH_TRIANGLES
from pftwin.geometry.mesh.mesh import SurfaceMesh

ROUNDING = 32 * float(np.finfo(np.float32).eps)  # bound on single precision's error, as a share of the coordinates
CANCELLED = 1e-6  # rounding of a difference of squares in single precision, with a margin


class MeshTree(eqx.Module):
    """A mesh and its tree. All arrays are pytree leaves, so another mesh of the same size reuses compiled programs."""

    triangles: Array  # (places, 9) corners a, b, c [m]; an empty place has a copy of another triangle
    index: Array  # (places,) int32: the triangle's index in the mesh; in an empty place, -1 - the copied one's index
    levels: tuple[Array, ...]  # (2^l, 8) float32 discs, the root first

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return len(self.levels) - 1

    @property
    def leaf(self) -> int:
        """Places per leaf."""
        return self.index.shape[-1] >> self.depth

    def source_index(self) -> Array:
        """Index of the mesh's triangle in each place, including copies, (places,)."""
        return jnp.where(self.index < 0, -1 - self.index, self.index)


def build_tree(mesh: SurfaceMesh, *, leaf: int = 4, depth: int | None = None) -> MeshTree:
    """Builds the tree of a mesh, or reads it from the cache if it was built before.

    Args:
        mesh: open or closed [m].
        leaf: largest number of triangles in a leaf.
        depth: levels below the root; None: as many as the mesh needs.

    Raises:
        InputError: a leaf of no triangles; a depth too small; a mesh with no triangles, too many, or not finite.
    """
    if not 1 <= leaf <= 64:
        raise InputError(f"leaves of {leaf} triangles", where="leaf", expected="1 to 64")
    check_searchable(mesh)
    deep = depth_for(len(mesh.faces), leaf)
    if depth is not None and depth < deep:
        raise InputError(f"a depth of {depth}", where="depth", expected=f"{deep} or more for this mesh")
    corners = np.ascontiguousarray(mesh.vertices[mesh.faces])
    triangles, index, levels = cached(tree_arrays, corners, leaf, deep if depth is None else depth, files=())
    own = triangles.astype(canonicalize_dtype(float))
    return MeshTree(jax.device_put(own), jax.device_put(index), tuple(jax.device_put(a) for a in levels))


def check_searchable(mesh: SurfaceMesh) -> None:
    """Raises InputError for a mesh with no triangles, with too many, or with coordinates that are not finite."""
    if not 0 < len(mesh.faces) <= MESH_TRIANGLES:
        raise InputError(f"{len(mesh.faces)} triangles", where=mesh.source, expected=f"1 to {MESH_TRIANGLES}")
    if not np.isfinite(mesh.vertices).all():
        raise InputError("vertices that are not finite", where=mesh.source, remedy="pftwin doctor-mesh")


def joined_tree(trees: Sequence[MeshTree]) -> MeshTree:
    """Joins two trees of the same depth and leaf size below a new root; a single tree is returned as it is.

    The second tree's triangles follow the first's; `index` still refers to each tree's own mesh.
    """
    if len(trees) == 1:
        return trees[0]
    below = [np.concatenate(pair) for pair in zip(*(t.levels for t in trees), strict=True)]
    triangles, index = (np.concatenate(x) for x in zip(*((t.triangles, t.index) for t in trees), strict=True))
    root = _discs(triangles.astype(np.float64).reshape(-1, 3, 3), 0)
    levels = tuple(jax.device_put(a) for a in (root, *below))
    return MeshTree(jax.device_put(triangles), jax.device_put(index), levels)


def tree_arrays(
    corners: NDArray[np.float64], leaf: int, depth: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], tuple[NDArray[np.float32], ...]]:
    """Triangles, index and levels of the tree (see `MeshTree`) of triangles with corners (n, 3, 3)."""
    index = median_order(corners.mean(axis=1), leaf, depth)
    placed = index.reshape(-1, leaf)
    # A leaf without triangles (in a tree deeper than necessary) repeats the leaf before it.
    full = np.maximum.accumulate(np.where(placed[:, 0] >= 0, np.arange(len(placed)), 0))
    places = np.where(placed >= 0, placed, placed[full, :1])
    triangles = corners[places.ravel()]
    index = np.where(placed >= 0, placed, -1 - places).ravel()
    levels = tuple(_discs(triangles, level) for level in range(depth + 1))
    return triangles.reshape(-1, 9), index.astype(np.int32), levels


def _discs(triangles: NDArray[np.float64], level: int) -> NDArray[np.float32]:
    """Discs (2^level, 8) of one level around a tree's triangles (places, 3, 3)."""
    margin = ROUNDING * float(np.abs(triangles).max())
    vectors = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return fit_discs(triangles.reshape(2**level, -1, 3), vectors.reshape(2**level, -1, 3), margin)


def depth_for(n: int, leaf: int) -> int:
    """Levels below the root of a complete tree of n triangles with at most `leaf` in each leaf."""
    return max(0, math.ceil(math.log2(n / leaf)))


def median_order(middles: NDArray[np.float64], leaf: int, depth: int) -> NDArray[np.int64]:
    """Triangle in each place of the tree, -1 if empty, (2^depth * leaf,), from the triangles' centroids (n, 3).

    `leaf` is the number of places per leaf, `depth` at least `depth_for(n, leaf)`.
    """
    n = len(middles)
    rows, counts = np.arange(n)[None], np.array([n])
    for _ in range(depth):
        rows, counts = _split(middles, rows, counts)
    places = np.full((2**depth, leaf), -1)
    places[:, : rows.shape[1]] = rows
    places[np.arange(leaf) >= counts[:, None]] = -1
    return places.ravel()


def _split(middles: NDArray, rows: NDArray, counts: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Splits the triangles of each row into two rows; entries beyond a row's count are copies of its first."""
    n_rows, width = rows.shape
    p = middles[rows]
    axis = np.argmax(np.ptp(p, axis=1), axis=1)
    key = np.take_along_axis(p, axis[:, None, None], axis=2)[:, :, 0]
    key = np.where(np.arange(width) < counts[:, None], key, np.inf)
    rows = np.take_along_axis(rows, np.argsort(key, axis=1, kind="stable"), axis=1)
    left, right = (counts + 1) // 2, counts // 2
    half = (width + 1) // 2
    place = np.arange(half)
    first = np.where(place < left[:, None], place, 0)
    second = np.minimum(left[:, None] + np.where(place < right[:, None], place, 0), width - 1)
    halves = np.stack([np.take_along_axis(rows, k, axis=1) for k in (first, second)], axis=1)
    return halves.reshape(2 * n_rows, half), np.stack([left, right], axis=1).ravel()


# A disc is a flat round slab along the surface: middle, unit normal, radius, half thickness (8). It follows the
# surface's direction and so separates facets that face each other closely, where axis-aligned boxes would overlap.


def fit_discs(corners: NDArray[np.float64], vectors: NDArray[np.float64], margin: float) -> NDArray[np.float32]:
    """Discs (nodes, 8) around points (nodes, k, 3), normal to the mean of area vectors (nodes, m, 3)."""
    normal = vectors.sum(axis=1)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(size > 0, normal / np.where(size > 0, size, 1), np.array([0.0, 0.0, 1.0]))
    normal = normal.astype(np.float32).astype(np.float64)  # rounded as it is stored
    least = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = np.cross(normal, least)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    axes = np.stack([u, np.cross(normal, u), normal], axis=1)
    local = corners @ np.swapaxes(axes, 1, 2)
    low, high = local.min(axis=1), local.max(axis=1)
    middle = 0.5 * (low + high)
    in_plane = local[:, :, :2] - middle[:, None, :2]
    radius = np.sqrt((in_plane**2).sum(axis=2).max(axis=1))
    center = np.einsum("nij,ni->nj", axes, middle)
    sizes = np.stack([radius, 0.5 * (high - low)[:, 2]], axis=1) + margin
    return np.concatenate([center, normal, sizes], axis=1).astype(np.float32)


def disc_distances(rows: Array, point: Array) -> Array:
    """Lower bounds (...) on the distance from a point (3,) to the surface in discs (..., 8) [m]."""
    away = Vec3(*(point[i] - rows[..., i] for i in range(3)))
    height = jnp.abs(away.dot(Vec3(*(rows[..., 3 + i] for i in range(3)))))
    beside = jnp.sqrt(jnp.maximum(away.squared_norm() - height * height, 0))
    radius, thickness = rows[..., 6], rows[..., 7]
    over, beyond = jnp.maximum(height - thickness, 0), jnp.maximum(beside - radius, 0)
    return jnp.sqrt(over * over + beyond * beyond)


def discs_overlap(a: Array, b: Array, rotation: Rotation, position: Vec3) -> Array:
    """Whether discs a (8, ...) and b (8, ...), one component per row, may overlap.

    They do not if a separating axis is found: either's normal, or the line between their middles. `rotation` and
    `position` are those of b's frame in a's.
    """
    m, n = Vec3(*a[3:6]), rotation.apply(Vec3(*b[3:6]))
    away = rotation.apply(Vec3(*b[:3])) + position - Vec3(*a[:3])
    (ra, ta), (rb, tb) = ((rows[6], rows[7]) for rows in (a, b))
    along = m.dot(n)
    tilted = jnp.abs(1 - along * along) + CANCELLED  # square of the sine of the angle between them
    along = jnp.abs(along)
    over_a, over_b, square = jnp.abs(away.dot(m)), jnp.abs(away.dot(n)), away.squared_norm()
    # Squares are compared to avoid roots: x > r sqrt(s) if x > 0 and x^2 > r^2 s.
    beyond_a, beyond_b = over_a - ta - tb * along, over_b - tb - ta * along
    disjoint = _exceeds_root(beyond_a, rb * rb * tilted) | _exceeds_root(beyond_b, ra * ra * tilted)
    # Along the line between the middles, times its length, each disc extends r sqrt(s). (ra sqrt(s_a) + rb sqrt(s_b))^2
    # is at most (ra + rb) (ra s_a + rb s_b), and nearly equal to it if both discs have similar directions.
    lost = CANCELLED * square
    aside_a, aside_b = (jnp.abs(square - over * over) + lost for over in (over_a, over_b))
    between = square - ta * over_a - tb * over_b
    return ~(disjoint | _exceeds_root(between, (ra + rb) * (ra * aside_a + rb * aside_b)))


def _exceeds_root(length: Array, square: Array) -> Array:
    """Whether a length, which may be negative, exceeds the root of a square."""
    return (length > 0) & (length * length > square)
