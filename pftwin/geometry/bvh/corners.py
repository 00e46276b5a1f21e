"""A mesh's corners with their outward normals, in a tree of discs and spherical shells.

A shell tells how far inside another body a corner can be much better than a flat slab does: pieces of a button are
nearly spherical, however large.
"""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np
from jax.dtypes import canonicalize_dtype
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.program_cache import cached
from pftwin.geometry.bvh import discs
from pftwin.geometry.bvh.order import depth_for, median_order
from pftwin.geometry.bvh.tree import ROUNDING

FLAT = 0.2  # [m]: no shell is rounder than that: single precision would not resolve it
Floats = NDArray[np.float64]


class CornerTree(eqx.Module):
    """One corner in each leaf of a complete tree; arrays are leaves of the pytree."""

    points: Array  # (places, 3) [m]
    normals: Array  # (places, 3) unit, outward
    index: Array  # (places,) int32: which vertex of the mesh; an empty place repeats another
    levels: tuple[Array, ...]  # (2^l, 14) float32: a disc (8) and a shell (6) around each node's corners

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return len(self.levels) - 1


def corner_tree(points: Floats, normals: Floats) -> CornerTree:
    """The tree of corners (n, 3) [m] with unit outward normals (n, 3)."""
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
        # A single corner has a normal but no curvature: that of the two around it.
        radius = _radius(v - middle[:, None], out - mean[:, None]) if level < depth else np.repeat(radius, 2)
        shell = _shell(v, out, middle - radius[:, None] * mean, np.sign(radius), margin)
        levels.append(np.concatenate([discs.fit(v, out, margin), shell], axis=1))
    return index.astype(np.int32), tuple(levels)


def _radius(away: Floats, turn: Floats) -> Floats:
    """Of the sphere whose normals turn by what corners' do, at as far from their middle; negative where they open."""
    radius = (away * turn).sum(axis=(1, 2)) / np.maximum((turn * turn).sum(axis=(1, 2)), 1e-12)
    return np.where((np.abs(radius) < FLAT) & (radius != 0), radius, FLAT)


def _shell(v: Floats, n: Floats, middle: Floats, sign: Floats, margin: float) -> NDArray[np.float32]:
    """Spherical shells (nodes, 6) around corners (nodes, k, 3) with unit normals: middle, radius, half thickness, tilt.

    The radius is negative where the middle is outside; the tilt is one less the least cosine between a corner's normal
    and the sphere's.
    """
    arms = v - middle[:, None]
    lengths = np.linalg.norm(arms, axis=2)
    low, high = lengths.min(axis=1), lengths.max(axis=1)
    cosine = sign[:, None] * (arms * n).sum(axis=2) / np.maximum(lengths, 1e-12)
    half = 0.5 * (high - low) + margin + 1e-6 * high
    own = np.stack([sign * 0.5 * (low + high), half, 1 - cosine.min(axis=1) + 1e-6], axis=1)
    return np.concatenate([middle, own], axis=1).astype(np.float32)
