"""Leaves of pytrees: conversion from and to host arrays without compilation, tangents, and functions that JAX traces
only once."""

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
    """A JAX array of any shape in JAX's default float type."""
    return jax.device_put(np.array(value, canonicalize_dtype(float)))  # a copy, since JAX may share the memory


def vector(values: ArrayLike) -> Vec3:
    """A `Vec3` from an array (..., 3), in JAX's default float type."""
    return Vec3(*(number(np.asarray(values)[..., k]) for k in range(3)))


def host_array(value: Vec3 | Quaternion | Rotation) -> Floats:
    """`value.array()`, of shape (..., 3), (..., 4) or (..., 3, 3), on the host in double precision."""
    parts = [getattr(value, field.name) for field in fields(value)]
    return np.stack([host_array(p) if isinstance(p, Vec3) else np.asarray(p, np.float64) for p in parts], axis=-1)


def split_by_tangent(values: Tree, changes: Any) -> tuple[Tree, Tree]:
    """Partitions primals into those with a tangent and those whose tangent is None, as `equinox.partition` does.

    Instantiating zero tangents for large constant tables would cost as much memory traffic as the tables themselves.
    """
    return eqx.partition(values, jax.tree.map(lambda c: c is not None, changes, is_leaf=lambda c: c is None))


def filled_tangents(values: Tree, changes: Any) -> Tree:
    """Tangents of primals in a derivative rule, with zeros in place of None."""

    def known(x: Any, change: Any) -> Any:
        return None if x is None else jnp.zeros_like(x) if change is None else change

    return jax.tree.map(known, values, changes, is_leaf=lambda x: x is None)


class Fixed(NamedTuple):
    """The static parts of a function's arguments: all but the arrays."""

    structure: Any
    leaves: tuple[Hashable, ...]  # per leaf: None for an array, else its type and value

    def with_arrays(self, arrays: Iterable[Any]) -> Any:
        """Recombines the static parts with arrays to the arguments."""
        rest = iter(arrays)
        leaves: list[Any] = [next(rest) if leaf is None else cast(tuple[Any, Any], leaf)[1] for leaf in self.leaves]
        return jax.tree.unflatten(self.structure, leaves)


def split_arguments(args: Any, is_array: Callable[[Any], bool] = eqx.is_array) -> tuple[Fixed, list[Any]]:
    """Splits arguments into their static parts, which determine a program, and its input arrays."""
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
    """Decorator: JAX traces the function once per structure and shapes of the arguments, and reuses the trace.

    The compiled programs do not change. Contacts use it, so that tracing the second program of a process takes half
    the time.
    """

    @functools.partial(jax.jit, static_argnums=0, inline=True)
    def of_arrays(fixed: Fixed, arrays: Sequence[Any]) -> Any:
        return function(*fixed.with_arrays(arrays))

    @functools.wraps(function)
    def traced(*args: Any) -> Any:
        return of_arrays(*split_arguments(args))

    return cast(F, traced)
