"""Derivatives of what equations define: against a closed form, against differences in contact, and what they cost."""

from __future__ import annotations

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, knee, settled

from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import Newmark
from pftwin.dynamics.solve import changed_by, solution_changes, tangent_of

FRAMES = 41


def test_the_solution_of_six_equations():
    """x_i^3 + sum_j A_ij x_j = p b_i, by p and by A; what does not change is told so."""
    random = np.random.default_rng(1)
    a = np.eye(6) + 0.3 * random.normal(size=(6, 6))
    x0, b = random.normal(size=6), random.normal(size=6)
    d_a = random.normal(size=(6, 6))

    def residual(x, given):
        matrix, p, right = given
        return [x[i] ** 3 + sum(matrix[i, j] * x[j] for j in range(6)) - p * right[i] for i in range(6)]

    @jax.jit
    def changes(matrix, d_matrix):
        x, given = [J(c) for c in x0], (matrix, J(2.0), J(b))
        tangent = tangent_of(lambda y: residual(y, given), x)
        right = changed_by(lambda g: residual(x, g), given, (d_matrix, J(1.0), None))
        return tangent, jnp.stack(solution_changes(tangent, right))

    tangent, d = changes(J(a), J(d_a))
    np.testing.assert_allclose(tangent, a + np.diag(3 * x0**2), rtol=1e-13)
    np.testing.assert_allclose(d, np.linalg.solve(a + np.diag(3 * x0**2), b - d_a @ x0), rtol=1e-11)


@pytest.fixture(scope="module")
def held():
    scene = knee(FRAMES)
    return scene, settled(scene)


def places(theta, held, substeps) -> jax.Array:
    """Centre of mass at the frames, by both tendons' stiffness and slack length (relative), (frames, 3)."""
    scene, start = held
    where = [lambda s, i=i, f=f: getattr(s.effects[i], f) for i in (1, 2) for f in ("stiffness", "slack_length")]
    changed = eqx.tree_at(
        lambda s: [w(s) for w in where], scene, [w(scene) * (1 + theta[i]) for i, w in enumerate(where)]
    )
    found = frame_states(changed, integrator=Newmark(), substeps=substeps, start=start)
    return found.states.position.array()


@pytest.fixture(scope="module")
def programs(held):
    plain = jax.jit(lambda theta, n: places(theta, held, n))
    columns = jax.jit(jax.jacfwd(lambda theta, n: places(theta, held, n)))
    return plain, columns


@pytest.mark.slow
def test_every_frame_in_contact_agrees_with_differences(programs):
    """The button lies on both facets from the first step on, which is the frame that a mistake would not leave."""
    plain, columns = programs
    forward, h = np.asarray(columns(jnp.zeros(4), J(40))), 1e-6
    for k, e in enumerate(np.eye(4)):
        difference = (np.asarray(plain(J(h * e), J(40))) - np.asarray(plain(J(-h * e), J(40)))) / (2 * h)
        np.testing.assert_allclose(forward[..., k], difference, atol=1e-5 * np.abs(difference).max())
        assert np.abs(forward[1, :, k]).max() > 1e-7


@pytest.mark.slow
def test_four_columns_are_not_computed_anew_for_every_entry(programs):
    """Residuals once stacked into one array were: 800 runs on the rig, where five to seven are right.

    No speed is tested: it is an order of magnitude that separates the two. Ten runs at a time, for clocks of a process
    tick once in 10 ms on some machines.
    """
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(4):
        for program, own in zip(programs, times, strict=True):
            began = time.process_time()
            for _ in range(10):
                jax.block_until_ready(program(jnp.zeros(4), J(40)))
            own.append(time.process_time() - began)
    plain, columns = (min(own[1:]) for own in times)
    assert columns < 60 * plain
