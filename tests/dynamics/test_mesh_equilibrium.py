"""Equilibria on meshes so coarse that hardly a triangle is in contact: forces jump from one to the next."""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scenes import OPTIMISED, vec
from toy_mesh_scenes import BALL, CONTOURS, foundation
from toy_scene_files import load

from pftwin.dynamics import equilibrium
from pftwin.dynamics.frame_states import starting_equilibrium


@pytest.mark.slow
def test_a_button_of_large_triangles_finds_its_rest(toy: Path) -> None:
    """By Newton's iteration alone, from most starts; before, from none: its steps led from facet to facet for ever."""
    scene = load(toy, foundation(button=BALL.replace("deviation_mm = 0.1", "deviation_mm = 0.3")))
    starts = [-0.005, 0.001, 0.05] + np.random.default_rng(0).uniform(-1, 1, (8, 3)) * [0.004, 0.004, 0.002]
    numbers, rest = eqx.partition(scene, eqx.is_array)
    settled = jax.jit(lambda a: starting_equilibrium(eqx.combine(a, rest)), compiler_options=OPTIMISED)
    solutions = [settled(eqx.tree_at(lambda s: s.start.position, numbers, vec(*p))) for p in starts]
    found = [s for s in solutions if bool(s.converged())]
    assert len(found) >= 4
    for solution in found:
        assert int(solution.iterations) > equilibrium.PATIENCE  # or this is no test of what comes after it
        stiffness = np.asarray(solution.stiffness)  # not symmetric where an edge of the femur's mesh is nearest
        assert (np.linalg.eigvalsh(stiffness + stiffness.T) > 0).all()


def test_a_load_that_is_not_known_is_no_equilibrium() -> None:
    assert np.isnan(equilibrium._size([jnp.asarray(1.0), jnp.asarray(np.nan)]))
    assert float(equilibrium._size([jnp.asarray(3.0), jnp.asarray(4.0)])) == 5


@pytest.mark.slow
def test_contours_have_an_equilibrium_and_it_follows_its_parameters(toy: Path) -> None:
    """Their tangent is not symmetric; taken for symmetric, it found no rest and its derivatives were wrong."""
    scene = load(toy, CONTOURS)
    quadriceps = scene.effects[1]
    assert quadriceps.name == "quadriceps"

    @jax.jit
    def follow(factor: Array, direction: Array) -> tuple[tuple[Array, Array, Array], Array]:
        def pose(factor: Array) -> tuple[Array, tuple[Array, Array]]:
            here = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, quadriceps.stiffness * (1 + factor))
            found = starting_equilibrium(here)
            row = jnp.concatenate([1e3 * found.pose.position.array(), found.pose.orientation.array()])
            return row, (found.residual, found.stiffness)

        (row, rest), (slope, _) = jax.jvp(pose, (factor,), (direction,))
        return (row, *rest), slope

    h = 5e-5
    (_, left, stiffness), slope = follow(jnp.zeros(()), jnp.ones(()))
    ends = [follow(jnp.asarray(a), jnp.ones(()))[0] for a in (h, -h)]
    assert max(float(left), *(float(end[1]) for end in ends)) < 1e-7
    asymmetry = np.asarray(stiffness - stiffness.T)
    assert np.abs(asymmetry).max() > 0.02 * np.abs(stiffness).max()
    difference = (ends[0][0] - ends[1][0]) / (2 * h)
    for part in (slice(3), slice(3, 7)):  # position [mm], quaternion
        size = np.linalg.norm(difference[part])
        np.testing.assert_allclose(slope[part] / size, difference[part] / size, rtol=0, atol=2e-4)
    assert np.abs(slope).max() > 0.1  # mm for a doubled stiffness: there is something to compare
