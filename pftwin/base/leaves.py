"""Leaves of pytrees: from the host's numbers and back, with no program compiled for each shape; their tangents; and
functions of them that JAX traces only once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from numpy.typing import ArrayLike

from pftwin.base.arrays import Floats
from pftwin.base.spatial import Quaternion, Rotation, Scalar, Vec3

Tree = TypeVar("Tree")
F = TypeVar("F", bound=Callable[..., Any])


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


class Fixed(NamedTuple):
    """The parts of a function's arguments that are not arrays."""

    structure: Any
    leaves: tuple[Hashable, ...]  # of every leaf None, or for one that is no array its type and itself

    def with_arrays(self, arrays: Iterable[Any]) -> Any:
        """The arguments."""
        rest = iter(arrays)
        leaves: list[Any] = [next(rest) if leaf is None else cast(tuple[Any, Any], leaf)[1] for leaf in self.leaves]
        return jax.tree.unflatten(self.structure, leaves)


def split_arguments(args: Any, is_array: Callable[[Any], bool] = eqx.is_array) -> tuple[Fixed, list[Any]]:
    """Splits arguments into what determines a program and the arrays that it takes."""
    leaves, structure = jax.tree.flatten(args)
    arrays: list[Any] = []
    fixed: list[Hashable] = []
    for leaf in leaves:
        here = is_array(leaf)
        fixed.append(None if here else (type(leaf), leaf))
        if here:
            arrays.append(leaf)
    return Fixed(structure, tuple(fixed)), arrays


def traced_once(function: F) -> F:
    """JAX traces the function once for each kind of arguments and reuses the trace wherever else it is called.

    The programs are the same. Where contacts are traced this way, a process's second program is traced in half the
    time.
    """

    @functools.partial(jax.jit, static_argnums=0, inline=True)
    def of_arrays(fixed: Fixed, arrays: Sequence[Any]) -> Any:
        return function(*fixed.with_arrays(arrays))

    @functools.wraps(function)
    def traced(*args: Any) -> Any:
        return of_arrays(*split_arguments(args))

    return cast(F, traced)
