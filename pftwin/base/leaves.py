"""Leaves of a scene from the host's numbers and back, no program compiled for each shape, and their tangents."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from numpy.typing import ArrayLike

from pftwin.base.arrays import Floats
from pftwin.base.spatial import Quaternion, Rotation, Scalar, Vec3

Tree = TypeVar("Tree")


def number(value: ArrayLike) -> Scalar:
    """A number, or an array of them, in JAX's default float type."""
    return jax.device_put(np.array(value, canonicalize_dtype(float)))  # a copy, since JAX may share the memory


def vector(values: ArrayLike) -> Vec3:
    """Vectors along the last axis (..., 3), likewise."""
    return Vec3(*(number(np.asarray(values)[..., k]) for k in range(3)))


def host_array(value: Vec3 | Quaternion | Rotation) -> Floats:
    """What `value.array()` gives, (..., 3), (..., 4) or (..., 3, 3), on the host and in double precision."""
    parts = [getattr(value, field.name) for field in fields(value)]
    return np.stack([host_array(p) if isinstance(p, Vec3) else np.asarray(p, np.float64) for p in parts], axis=-1)


def what_changes(values: Tree, changes: Any) -> tuple[Tree, Tree]:
    """The values for which a rule for derivatives gets changes, and the others; None in place of what is in the other.

    A zero for each entry of a table that does not change would be read and copied as the table is.
    """
    return eqx.partition(values, jax.tree.map(lambda c: c is not None, changes, is_leaf=lambda c: c is None))


def all_changes(values: Tree, changes: Any) -> Tree:
    """Changes of values as a rule for derivatives gets them, with zeros where it is told None: nothing changes."""

    def known(x: Any, change: Any) -> Any:
        return None if x is None else jnp.zeros_like(x) if change is None else change

    return jax.tree.map(known, values, changes, is_leaf=lambda x: x is None)
