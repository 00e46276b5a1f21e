"""Searches that take a batch's members in turns."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params
from jaxtyping import Array

from pftwin.geometry.bvh.loops import member_by_member, most_in_batch

cpu_only = pytest.mark.skipif(jax.default_backend() != "cpu", reason="elsewhere batches are worked on at once")


class Answer(NamedTuple):
    steps: Array
    near: tuple[Array, Array]
    odd: Array


def halved(x: Array, limit: Array) -> Answer:
    """How often a number can be halved above a limit: as many turns as it takes."""
    more = jax.lax.while_loop(lambda s: s[1] > limit, lambda s: (s[0] + 1, s[1] / 2), (jnp.int32(0), x))
    return Answer(more[0], (jnp.stack([more[1], x]), jnp.arange(3, dtype=jnp.int32) + more[0]), more[0] % 2 == 1)


NUMBERS, LIMITS = jnp.array([1.0, 90.0, 7.0, 0.1]), jnp.array([0.5, 3.0])


def _same(found: Answer, k: tuple[int, ...], alone: Answer) -> None:
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a[k], b)


def test_a_batch_of_a_batch_has_each_members_answer():
    search = member_by_member(halved)
    found = jax.jit(jax.vmap(lambda limit: jax.vmap(lambda x: search(x, limit))(NUMBERS)))(LIMITS)
    for i, limit in enumerate(LIMITS):
        for j, x in enumerate(NUMBERS):
            _same(found, (i, j), halved(x, limit))


def test_nothing_is_differentiated_and_derivatives_pass():
    search = member_by_member(halved)
    slopes = jax.vmap(jax.grad(lambda x: x * search(x, jnp.asarray(0.5)).near[0][0]))(NUMBERS)
    np.testing.assert_allclose(slopes, [halved(x, jnp.asarray(0.5)).near[0][0] for x in NUMBERS])


@cpu_only
def test_one_array_of_each_type_is_stacked():
    closed = jax.make_jaxpr(jax.vmap(member_by_member(halved), in_axes=(0, None)))(NUMBERS, LIMITS[0])
    loops = [e for e in _equations(closed.jaxpr) if e.primitive.name == "scan"]
    assert [sorted(str(v.aval.dtype) for v in e.outvars) for e in loops] == [["bool", "float64", "int32"]]


def _equations(jaxpr):
    for e in jaxpr.eqns:
        yield e
        for inner in jaxprs_in_params(e.params) if e.primitive.name != "scan" else ():
            yield from _equations(inner)


def test_the_most_of_a_batch_is_one_number_for_all():
    counts = jnp.array([[3, 9, 4], [7, 2, 5]], jnp.int32)
    found = jax.vmap(jax.vmap(lambda c: (c, most_in_batch(c))))(counts)
    np.testing.assert_array_equal(found[1], np.full((2, 3), 9))
    assert int(most_in_batch(counts[0, 0])) == 3

    def branch(c: Array) -> Array:
        return jax.lax.cond(most_in_batch(c) > 5, lambda: 1.0, lambda: 2.0)

    # A branch is taken; by a condition of each member's own both would be.
    assert "cond" in str(jax.make_jaxpr(jax.vmap(branch))(counts[0]))
