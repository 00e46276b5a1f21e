"""Numbers of the host as leaves of a scene, without a program being compiled for each of their shapes."""

from __future__ import annotations

import jax
import numpy as np
from jax.dtypes import canonicalize_dtype
from numpy.typing import ArrayLike

from pftwin.spatial import Scalar, Vec3


def number(value: ArrayLike) -> Scalar:
    """A number, or an array of them, in JAX's default float type."""
    return jax.device_put(np.array(value, canonicalize_dtype(float)))  # a copy: JAX may look at the very memory


def vector(values: ArrayLike) -> Vec3:
    """Vectors along the last axis (..., 3), likewise."""
    return Vec3(*(number(np.asarray(values)[..., k]) for k in range(3)))
