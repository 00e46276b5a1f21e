"""What the float type makes of an equilibrium: how large a residual its rounding leaves."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.equilibrium import Solution, tolerance_of, tolerance_on_host
from pftwin.dynamics.frame_states import first_guide, starting_equilibrium
from pftwin.dynamics.state import System
from pftwin.dynamics.static_load import displaced_pose, residual
from pftwin.studies.hard_cases import case_named
from pftwin.studies.hard_cases.batch import built_scene

CASES = ("contact_hard", "button_of_1_m")


def load(scene, memories, poses):
    """(n, 6): what is left of the load at poses."""
    system, guide = System.of(scene), first_guide(scene)
    return jax.lax.map(lambda pose: jnp.stack(residual(system, guide, pose, memories)), poses)


def doubled(tree):
    """The same numbers, computed with in double precision from here on."""
    return jax.tree.map(lambda a: np.asarray(a, np.float64) if eqx.is_inexact_array(a) else np.asarray(a), tree)


@pytest.fixture(scope="module")
def singles():
    """Equilibria in single precision, and the loads at the same poses beside them in single and in double."""
    found, given = {}, {}
    steps = jnp.asarray(np.random.default_rng(1).normal(0, 3e-8, (64, 6)).astype(np.float32))
    with jax.enable_x64(False):
        search, beside = jax.jit(starting_equilibrium), jax.jit(load)
        places = jax.jit(jax.vmap(lambda pose, step: displaced_pose(pose, list(step)), in_axes=(None, 0)))
        for name in CASES:
            scene = built_scene(case_named(name), "P5").unnamed()
            solution = search(scene)
            args = scene, solution.memories, places(solution.pose, steps)
            found[name], given[name] = (solution, np.asarray(beside(*args))), doubled(args)
    beside = jax.jit(load)
    return {name: (*found[name], np.asarray(beside(*given[name]))) for name in CASES}


@pytest.mark.parametrize("name", CASES)
def test_a_search_in_single_precision_ends_where_rounding_ends_it(singles, name):
    solution, _, _ = singles[name]
    assert bool(solution.converged())
    assert float(solution.tolerance()) == float(tolerance_on_host(solution)) > tolerance_of(np.dtype(np.float32))


@pytest.mark.parametrize("name", CASES)
def test_the_load_is_as_uncertain_as_is_said(singles, name):
    """At one and the same pose, in single and in double precision."""
    solution, single, double = singles[name]
    off = np.linalg.norm(single - double, axis=1)
    assert 0.02 * float(solution.rounding) < np.sqrt(np.mean(off**2)) < float(solution.rounding)


def test_usual_stiffness_leaves_the_tolerance_as_it_is():
    pose = Pose(Vec3.zero(), Quaternion.identity())
    left = jnp.asarray(2e-6)
    usual, hard = (Solution(pose, (), left, jnp.asarray(9), jnp.eye(6), jnp.asarray(r)) for r in (1e-9, 1e-5))
    assert float(usual.tolerance()) == float(tolerance_on_host(usual)) == 1e-6
    assert not bool(usual.converged())
    assert bool(hard.converged())
