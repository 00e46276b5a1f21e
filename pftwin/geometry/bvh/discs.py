"""Flat round slabs along the surface as bounding volumes. Rows of 8: middle, unit normal, radius, half thickness.

A piece of a smooth surface is much wider than thick, whichever way it faces. A disc turns with it, and so tells apart
facets that face and nearly follow each other, where boxes along fixed axes overlap.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

WIDTH = 8
CANCELLED = 1e-6  # what single precision may lose where a square is taken from one as large, and room


def fit(corners: NDArray[np.float64], vectors: NDArray[np.float64], margin: float) -> NDArray[np.float32]:
    """The discs (nodes, 8) of the points (nodes, k, 3), across the mean of area vectors (nodes, m, 3)."""
    normal = vectors.sum(axis=1)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(size > 0, normal / np.where(size > 0, size, 1), np.array([0.0, 0.0, 1.0]))
    normal = normal.astype(np.float32).astype(np.float64)  # as it is stored
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


def distances(rows: Array, point: Array) -> tuple[Array, Array]:
    """Bounds (...) on the distance from a point (3,) to the surface in discs (..., 8): at least, and at most."""
    away = [point[i] - rows[..., i] for i in range(3)]
    height = jnp.abs(_dot(away, [rows[..., 3 + i] for i in range(3)]))
    beside = jnp.sqrt(jnp.maximum(_dot(away, away) - height * height, 0))
    radius, thickness = rows[..., 6], rows[..., 7]
    over, beyond = jnp.maximum(height - thickness, 0), jnp.maximum(beside - radius, 0)
    far_over, far_beyond = height + thickness, beside + radius
    return jnp.sqrt(over * over + beyond * beyond), jnp.sqrt(far_over * far_over + far_beyond * far_beyond)


def overlap(a: Array, b: Array, rotation: Array, translation: Array) -> Array:
    """Whether discs a (8, ...) and b (8, ...), a component a row, may touch.

    They do not where a direction separates them: either's normal, or the line between their middles. b's frame in a's
    is given by rotation (3, 3) and translation (3,).
    """
    middle = [_dot(list(rotation[i]), list(b[:3])) + translation[i] for i in range(3)]
    n = [_dot(list(rotation[i]), list(b[3:6])) for i in range(3)]
    m = list(a[3:6])
    away = [middle[i] - a[i] for i in range(3)]
    (ra, ta), (rb, tb) = ((rows[6], rows[7]) for rows in (a, b))
    along = _dot(m, n)
    tilted = jnp.abs(1 - along * along) + CANCELLED  # square of the sine of the angle between them
    along = jnp.abs(along)
    over_a, over_b = jnp.abs(_dot(away, m)), jnp.abs(_dot(away, n))
    square = _dot(away, away)
    # Radii stand with roots, so squares are compared: x > r sqrt(s) where x > 0 and x^2 > r^2 s.
    beyond_a, beyond_b = over_a - ta - tb * along, over_b - tb - ta * along
    apart = _longer(beyond_a, rb * rb * tilted) | _longer(beyond_b, ra * ra * tilted)
    # Along the middles' line, times its length, discs reach r sqrt(s) each; (ra sqrt(s_a) + rb sqrt(s_b))^2 is at most
    # (ra + rb) (ra s_a + rb s_b), and hardly less where both discs lie alike.
    lost = CANCELLED * square
    aside_a, aside_b = (jnp.abs(square - over * over) + lost for over in (over_a, over_b))
    between = square - ta * over_a - tb * over_b
    return ~(apart | _longer(between, (ra + rb) * (ra * aside_a + rb * aside_b)))


def _longer(length: Array, square: Array) -> Array:
    """Whether a length, which may be negative, is more than the root of a square."""
    return (length > 0) & (length * length > square)


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
