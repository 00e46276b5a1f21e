"""Packing of a loop's outputs into one row per iteration.

A loop that stores dozens of scalars per iteration spends more time storing than computing, because each store is a
separate operation on an array as long as the loop. Storing one row of all of them is a single operation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array


class Layout(NamedTuple):
    """Arrangement of the leaves of a pytree in a row."""

    structure: Any
    leaves: list[jax.ShapeDtypeStruct]

    @staticmethod
    def of(function: Callable[..., Any], *args: Any) -> Layout:
        """Layout of the result of function(*args), without computing it."""
        leaves, structure = jax.tree.flatten(jax.eval_shape(function, *args))
        return Layout(structure, leaves)

    def row(self, value: Any) -> Array:
        """All leaves in a row (k,), in JAX's default float type, which is exact for flags and small integers too."""
        return jnp.concatenate([jnp.ravel(leaf).astype(float) for leaf in jax.tree.leaves(value)])

    def unpacked(self, table: Array) -> Any:
        """Inverse of `row` for rows (n, k): every leaf has a leading axis n."""
        values, begin = [], 0
        for leaf in self.leaves:
            end = begin + leaf.size
            values.append(table[:, begin:end].reshape(-1, *leaf.shape).astype(leaf.dtype))
            begin = end
        return jax.tree.unflatten(self.structure, values)


def map_rows(function: Callable[[Any], Any], xs: Any) -> Any:
    """`jax.lax.map(function, xs)`, with outputs stored as rows."""
    layout = Layout.of(function, jax.tree.map(lambda a: a[0], xs))
    return layout.unpacked(jax.lax.map(lambda x: layout.row(function(x)), xs))
