"""Derivatives of the solution x(p) of six equations r(x, p) = 0, however it was found: dx = -(dr/dx)^-1 (dr/dp) dp.

XLA recomputes scalar results for every entry of an array that they are stacked into. So the columns of dr/dx pass
through the numbers that a loop carries, which stores them, and right-hand sides are never stacked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.inverse_with_pivots import inverse_with_pivots

Six = list[Scalar]


def six(a: Vec3, b: Vec3) -> Six:
    """Components of two vectors."""
    return [a.x, a.y, a.z, b.x, b.y, b.z]


def tangent_of(residual: Callable[[Six], Six], x: Six) -> Array:
    """(6, 6), dr_i/dx_j in row i: one derivative after the other."""

    def one(last: Six, direction: Array) -> tuple[Six, Array]:
        change = jax.jvp(residual, (x,), ([direction[i] for i in range(6)],))[1]
        return change, jnp.stack(last)

    directions = jnp.eye(7, 6, dtype=x[0].dtype)  # one row more: each column is stored while the next one is computed
    return jax.lax.scan(one, [jnp.zeros_like(a) for a in x], directions)[1][1:].T


def changed_by(function: Callable[[Any], Any], values: Any, changes: Any) -> Any:
    """The change of function(values) for given changes of the values; None marks a value that does not change."""
    known = jax.tree.map(lambda c: c is not None, changes, is_leaf=lambda c: c is None)
    moving, still = eqx.partition(values, known)
    return jax.jvp(lambda m: function(eqx.combine(m, still)), (moving,), (changes,))[1]


def solution_changes(tangent: Array, right: Six) -> Six:
    """-(dr/dx)^-1 times a change of the residual at unchanged x."""
    inverse, _ = inverse_with_pivots(tangent)
    rows = [[inverse[i, j] * r for j, r in enumerate(right)] for i in range(6)]
    return [-sum(row[1:], start=row[0]) for row in rows]
