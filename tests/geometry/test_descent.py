"""The step towards the closest point: its derivative in every branch; its limits."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.geometry.patch.closest import FLATTEST, PUSH, DescentStep, descend

GRAM = (1.3, 1.1)
CASES = {  # gradient, Hessian (uu, uv, vv), longest steps
    "newton": ((0.02, -0.03), (1.2, 0.3, 0.9), (1.0, 1.0)),
    "flat_valley": ((0.02, -0.03), (1.2, 0.3, 0.12), (1.0, 1.0)),
    "flat_along": ((0.002, -0.003), (0.05, 0.01, 0.9), (1.0, 1.0)),
    "flat_both": ((0.002, -0.003), (0.05, 0.01, 0.04), (1.0, 1.0)),
    "saddle_across": ((0.02, -0.03), (1.2, 0.3, -0.8), (1.0, 1.0)),
    "saddle_along": ((0.02, -0.03), (-0.9, 0.3, 0.8), (1.0, 1.0)),
    "hilltop": ((0.02, -0.03), (-0.9, 0.3, -0.8), (1.0, 1.0)),
    "flat_saddle": ((0.002, -0.003), (1.2, 0.3, -0.02), (1.0, 1.0)),
    "long_across": ((0.02, -0.3), (1.2, 0.3, 0.9), (1.0, 0.1)),
    "long_along": ((0.4, -0.03), (1.2, 0.3, 0.9), (0.1, 1.0)),
    "long_both": ((0.4, 0.3), (1.2, -0.3, 0.9), (0.1, 0.1)),
    "long_from_a_saddle": ((0.02, -0.3), (1.2, 0.3, -0.8), (1.0, 0.1)),
}


def step_of(numbers: jax.Array, side: float = 1.0) -> DescentStep:
    gu, gv, uu, uv, vv, along, across = numbers
    gram = (jnp.asarray(GRAM[0]), jnp.asarray(GRAM[1]))
    return descend((gu, gv), (uu, uv, vv), gram, (along, across), side)


def moved(numbers: jax.Array) -> jax.Array:
    return jnp.stack(step_of(numbers)[:2])


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_differences(name: str) -> None:
    at = np.concatenate([np.ravel(part) for part in CASES[name]])
    finite = np.stack([(moved(at + h) - moved(at - h)) / 2e-6 for h in 1e-6 * np.eye(len(at))], axis=1)
    np.testing.assert_allclose(jax.jacfwd(moved)(jnp.asarray(at)), finite, atol=1e-8)
    np.testing.assert_allclose(jax.jacrev(moved)(jnp.asarray(at)), finite, atol=1e-8)


def test_where_nothing_is_flat_it_is_newtons() -> None:
    (gu, gv), (uu, uv, vv), _ = CASES["newton"]
    wanted = -np.linalg.solve([[uu, uv], [uv, vv]], [gu, gv])
    np.testing.assert_allclose(moved(jnp.asarray([gu, gv, uu, uv, vv, 1.0, 1.0])), wanted, rtol=1e-13)


def test_a_flat_valley_is_crept_along() -> None:
    step = step_of(jnp.asarray([0.0, -0.003, 1.2, 0.0, 1e-6, 1.0, 1.0]))
    assert float(step.dv) == pytest.approx(0.003 / (FLATTEST * GRAM[1]))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_on_a_saddle_it_is_pushed_to_its_side(side: float) -> None:
    step = step_of(jnp.asarray([0.0, 0.0, 1.2, 0.1, -0.8, 1.0, 0.5]), side)
    assert float(step.dv) == pytest.approx(side * PUSH * 0.5)
    assert float(step.convex) == 0
