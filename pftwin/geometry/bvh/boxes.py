"""Boxes along the mesh's axes as bounding volumes: simple, and the paper's. Rows of 6: middle and half size."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

WIDTH = 6


def fit(corners: NDArray[np.float64], vectors: NDArray[np.float64], margin: float) -> NDArray[np.float32]:
    """The boxes (nodes, 6) of the points (nodes, k, 3) that their triangles' corners are."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    return np.concatenate([0.5 * (low + high), 0.5 * (high - low) + margin], axis=1).astype(np.float32)


def overlap(a: Array, b: Array, rotation: Array, translation: Array) -> Array:
    """Whether boxes a (6, ...) and b (6, ...), a component a row, may touch.

    b's frame in a's is given by rotation (3, 3) and translation (3,).
    """
    apart, reach = [], []
    for i in range(3):
        middle = sum((rotation[i, j] * b[j] for j in range(3)), start=translation[i])
        apart.append(jnp.abs(middle - a[i]))
        reach.append(sum((jnp.abs(rotation[i, j]) * b[3 + j] for j in range(3)), start=a[3 + i]))
    return (apart[0] <= reach[0]) & (apart[1] <= reach[1]) & (apart[2] <= reach[2])
