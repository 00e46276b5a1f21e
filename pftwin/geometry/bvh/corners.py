"""A bounding volume hierarchy of a mesh's corners (vertices) and normals, bounded by discs and spherical shells.

A shell bounds the depth of corners in another body much more tightly than a flat slab: pieces of a button are nearly
spherical, however large.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.program_cache import cached
from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.bvh.tree import ROUNDING, depth_for, fit_discs, median_order
from pftwin.geometry.bvh.triangle import Triangle

ROUGH = 1e-7  # [m] margin: several times the rounding error of single precision
FLAT = 0.2  # [m] largest radius of a shell that single precision resolves


class CornerTree(eqx.Module):
    """A complete binary tree with one corner in each leaf (place); arrays are leaves of the pytree."""

    points: Array  # (places, 3) [m]
    normals: Array  # (places, 3) unit, outward
    index: Array  # (places,) int32: vertex of the mesh; an empty place repeats the one before it
    levels: tuple[Array, ...]  # (2^l, 14) float32: a disc (8) and a shell (6) around each node's corners

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return len(self.levels) - 1


def corner_tree(points: Floats, normals: Floats) -> CornerTree:
    """Builds the tree of corners (n, 3) [m] with unit outward normals (n, 3)."""
    index, levels = cached(_arrays, points, normals, files=())
    dtype = canonicalize_dtype(float)
    p, n = (jax.device_put(x[index].astype(dtype)) for x in (points, normals))
    return CornerTree(p, n, jax.device_put(index), tuple(jax.device_put(x) for x in levels))


def _arrays(points: Floats, normals: Floats) -> tuple[NDArray[np.int32], tuple[NDArray[np.float32], ...]]:
    depth = depth_for(len(points), 1)
    index = median_order(points, 1, depth)
    before = np.maximum.accumulate(np.where(index >= 0, np.arange(len(index)), 0))
    index = index[before]
    p, n = points[index], normals[index]
    margin = ROUNDING * float(np.abs(points).max())
    levels, radius = [], np.full(1, FLAT)
    for level in range(depth + 1):
        v, out = (x.reshape(1 << level, -1, 3) for x in (p, n))
        middle, mean = v.mean(axis=1), out.mean(axis=1)
        # A single corner has no curvature: its parent's is used.
        radius = _radius(v - middle[:, None], out - mean[:, None]) if level < depth else np.repeat(radius, 2)
        shell = _shell(v, out, middle - radius[:, None] * mean, np.sign(radius), margin)
        levels.append(np.concatenate([fit_discs(v, out, margin), shell], axis=1))
    return index.astype(np.int32), tuple(levels)


def _radius(away: Floats, turn: Floats) -> Floats:
    """Radius (nodes,) of the sphere fitted to corners and normals, both less their means; negative where concave."""
    radius = (away * turn).sum(axis=(1, 2)) / np.maximum((turn * turn).sum(axis=(1, 2)), 1e-12)
    return np.where((np.abs(radius) < FLAT) & (radius != 0), radius, FLAT)


def _shell(v: Floats, n: Floats, middle: Floats, sign: Floats, margin: float) -> NDArray[np.float32]:
    """Spherical shells (nodes, 6) around corners (nodes, k, 3) with unit normals: middle, radius, half thickness, tilt.

    The radius is negative if the middle is outside the body. The tilt is 1 - the smallest cosine between a corner's
    normal and the sphere's.
    """
    arms = v - middle[:, None]
    lengths = np.linalg.norm(arms, axis=2)
    low, high = lengths.min(axis=1), lengths.max(axis=1)
    cosine = sign[:, None] * (arms * n).sum(axis=2) / np.maximum(lengths, 1e-12)
    half = 0.5 * (high - low) + margin + 1e-6 * high
    own = np.stack([sign * 0.5 * (low + high), half, 1 - cosine.min(axis=1) + 1e-6], axis=1)
    return np.concatenate([middle, own], axis=1).astype(np.float32)


EDGE = 1e-12  # tolerance, as a share of the triangle, within which a ray that misses its edge still hits


def ray_depth(corner: Vec3, normal: Vec3, t: Triangle) -> tuple[Scalar, Array]:
    """Distance [m] along the ray from a corner, against its normal, to a triangle; and whether it exits there, bool."""
    across = t.area_vector()
    steep = -normal.dot(across)
    leaves = steep > 0
    depth = (t.a - corner).dot(across) / jnp.where(leaves, steep, 1)
    # Signed volumes: a ray that hits passes all edges on the same side.
    a, b, c = t.a - corner, t.b - corner, t.c - corner
    sides = [normal.dot(q.cross(p)) for p, q in ((a, b), (b, c), (c, a))]
    least = -EDGE * steep
    return depth, leaves & (sides[0] >= least) & (sides[1] >= least) & (sides[2] >= least)


def may_leave(a: Array, b: Array, X: Pose, deepest: Array) -> Array:
    """Whether the rays of single corners may exit through discs and be longer than the longest so far [m], bool.

    `a` and `b` are discs and single corners, one component per row (a corner's disc has the corner as its middle), X is
    the pose of b's frame in a's, single precision.
    """
    rotation = X.orientation.rotation()
    point, normal = rotation.apply(Vec3(*b[:3])) + X.position, rotation.apply(Vec3(*b[3:6]))
    away, axis = point - Vec3(*a[:3]), Vec3(*a[3:6])
    slope = -normal.dot(axis)
    steep = slope > 0.1
    over = 1 / jnp.where(steep, slope, 1.0)
    middle, half = -away.dot(axis) * over, (a[7] + ROUGH) * over + ROUGH
    beside = (away - middle * normal).squared_norm()
    allowed = a[6] + half + ROUGH
    passes = (middle + half > jnp.maximum(deepest, 0)) & (beside <= allowed * allowed)
    # No ray exits against a thin disc's normal; the triangles in a thick disc may face anywhere.
    back = (slope < -0.1) & (a[7] < 0.1 * a[6])
    return jnp.where(steep, passes, ~back)
