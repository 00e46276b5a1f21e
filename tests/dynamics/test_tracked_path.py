"""The path that results follow, and its derivatives: exact over a whole motion, beyond the patch's edge too."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pftwin
from pftwin.dynamics.tracked_path import tracked_path
from pftwin.scene import Scene

STEP = 2.5e-3  # [s]


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Near extension its button rests beyond the fitted patch's edge."""
    return pftwin.rig.case(1, contact="P5")


@pytest.mark.slow
def test_is_the_centre_of_a_result(scene: Scene) -> None:
    path = jax.jit(lambda: tracked_path(scene, substeps=4))()
    np.testing.assert_allclose(
        np.stack([path.x, path.y, path.z], axis=1), pftwin.simulate(scene, dt=STEP).center, atol=1e-9
    )


@pytest.mark.slow
def test_derivatives_are_those_of_finite_differences_beyond_the_edge_too(scene: Scene) -> None:
    at = scene.index("quadriceps")
    nominal = scene.effects[at].stiffness  # pyright: ignore[reportAttributeAccessIssue]

    def path(share: jax.Array) -> jax.Array:
        softer = eqx.tree_at(lambda s: s.effects[at].stiffness, scene, nominal * (1 + share))
        return tracked_path(softer, integrator="linear_implicit_bdf2", substeps=4).array()

    run, slope = jax.jit(path), jax.jit(lambda: jax.jvp(path, (jnp.zeros(()),), (jnp.ones(()),))[1])
    exact, h = np.asarray(slope()), 1e-5
    finite = np.asarray(run(jnp.asarray(h)) - run(jnp.asarray(-h))) / (2 * h)
    assert pftwin.simulate(scene, dt=STEP).status & pftwin.Status.LEFT_PATCH
    # All but the height at the end of a step, which is differentiated as an expansion of second order.
    off = np.abs(exact - finite).max(axis=1) / np.abs(finite).max()
    assert np.median(off) < 1e-7
    assert off.max() < 5e-4
