"""Numbers of the host as leaves."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.leaves import number, vector


@pytest.mark.parametrize("value", [1, 1.5, np.float32(2), [1, 2], np.arange(6).reshape(2, 3)])
def test_leaves_are_strongly_typed_arrays_of_the_default_type(value):
    leaf = number(value)
    assert isinstance(leaf, jax.Array)
    assert (leaf.dtype, leaf.weak_type, leaf.shape) == (jnp.float64, False, np.shape(value))
    assert np.array_equal(leaf, value)
    with jax.enable_x64(False):
        assert number(value).dtype == jnp.float32


def test_a_leaf_does_not_follow_the_array_it_came_from():
    values = np.arange(1000.0)
    leaf = number(values)
    values[:] = -1
    assert float(leaf[7]) == 7


def test_vectors_lie_along_the_last_axis():
    values = np.arange(12.0).reshape(4, 3)
    v = vector(values)
    assert np.array_equal(v.array(), values)
    assert vector([1, 2, 3]).x.shape == ()


def test_nothing_is_compiled():
    compiled = []

    def note(event: str, _: float, **about: object) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(about)

    jax.monitoring.register_event_duration_secs_listener(note)
    before = len(compiled)
    vector(np.arange(3 * 37.0).reshape(37, 3))
    assert len(compiled) == before
