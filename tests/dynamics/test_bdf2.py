"""BDF2's own steps: its formula on a constant force, and where it starts afresh."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, G, J, contact, gravity, record, state_at, still_guide, still_guide_at, system, vec

from pftwin.base.spatial import Twist
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.integrators.bdf2 import LEVER, ROUGH
from pftwin.model.effects.contact_law import Hertz

STEP = 1e-3
FREE = system(gravity())


def test_the_first_step_is_eulers_and_the_rest_follow_the_formula():
    """d = d / 3 + 2 h v / 3 with v = -g t, from rest: -1, -5/3, -23/9 of g h^2."""
    states, _ = record(FREE, state_at(FREE, (0, 0, 1)), J(STEP), 3, BDF2())
    np.testing.assert_allclose(states.velocity.z, -G * STEP * np.arange(1, 4), rtol=1e-12)
    ways = np.diff([1.0, *np.asarray(states.position.z)])
    np.testing.assert_allclose(ways, -G * STEP**2 * np.array([1, 5 / 3, 23 / 9]), rtol=1e-9)


@eqx.filter_jit
def share_after(linear, angular):
    """The share that the next step has of this one, which falls freely, after one whose velocities changed so."""
    start = BDF2().begin(FREE, state_at(FREE, (0, 0, 1)), still_guide(), J(STEP))
    change = Twist(*(jax.tree.unflatten(jax.tree.structure(start.velocity), list(a)) for a in (linear, angular)))
    start = eqx.tree_at(lambda s: s.solver_state.change, start, change)
    return BDF2().advance(FREE, start, still_guide_at, J(STEP), None)[0].solver_state.share


@pytest.mark.parametrize(
    ("linear", "angular", "share"),
    [
        ((0, 0, -G * STEP), (0, 0, 0), 1 / 3),  # as before
        ((0, 0, -G * STEP + 0.9 * ROUGH * STEP), (0, 0, 0), 1 / 3),  # otherwise, but not by more than is rough
        ((0, 0, -G * STEP + 1.1 * ROUGH * STEP), (0, 0, 0), 0),
        ((1.1 * ROUGH * STEP, 0, -G * STEP), (0, 0, 0), 0),
        ((0, 0, -G * STEP), (0.9 * ROUGH * STEP / LEVER, 0, 0), 1 / 3),
        ((0, 0, -G * STEP), (0, 1.1 * ROUGH * STEP / LEVER, 0), 0),
    ],
)
def test_after_a_change_of_another_kind_the_next_step_starts_afresh(linear, angular, share):
    assert float(share_after(J(np.array(linear, float)), J(np.array(angular, float)))) == pytest.approx(share)


def test_a_change_by_less_than_half_is_no_impact():
    """Ever harder braking: what counts is the change against this step's own, however large both are."""
    heavy = system(eqx.tree_at(lambda g: g.acceleration, gravity(), vec(0, 0, -1e3)))
    for before, share in ((-0.6e3, 1 / 3), (-0.4e3, 0)):  # 400 and 600 m/s^2 of 1000
        start = BDF2().begin(heavy, state_at(heavy, (0, 0, 1)), still_guide(), J(STEP))
        start = eqx.tree_at(lambda s: s.solver_state.change.linear.z, start, J(before * STEP))
        after = BDF2().advance(heavy, start, still_guide_at, J(STEP), None)[0]
        assert float(after.solver_state.share) == pytest.approx(share)


def test_a_fresh_step_forgets_the_past():
    """Displacement and velocity are those of a body that has just been let go with its velocity."""
    v = 0.3
    start = state_at(FREE, (0, 0, 1), (v, 0, 0))
    begun = BDF2().begin(FREE, start, still_guide(), J(STEP))
    past = Twist(vec(-5.0, 4.0, 3.0), vec(1.0, 2.0, 3.0))
    solver_state = eqx.tree_at(lambda s: (s.solver_state.displacement, s.solver_state.change), begun, (past, past))
    for state in (begun, solver_state):
        after = BDF2().advance(FREE, state, still_guide_at, J(STEP), None)[0]
        np.testing.assert_allclose(after.position.array(), [v * STEP, 0, 1 - G * STEP**2], rtol=1e-12)
        np.testing.assert_allclose(after.velocity.array(), [v, 0, -G * STEP], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(after.spin.array(), 0, atol=1e-15)


def test_no_bounce_gains_height():
    """Lossless contact, dropped from 16 heights: the step that leaves the ground does not go on with the impact."""
    heights = jnp.linspace(1e-3, 0.03, 16)

    def highest_after_touch(height):
        sys = system(gravity(), contact(Hertz(J(2e8))))
        states, _ = record(sys, state_at(sys, (0, 0, RADIUS + height)), J(STEP), 300, BDF2())
        z = states.position.z - RADIUS
        leaves = (jnp.cumsum(z < 0) > 0) & (z > 0)
        return jnp.max(jnp.where(leaves, z, 0.0)) / height

    assert np.asarray(jax.jit(jax.vmap(highest_after_touch))(heights)).max() < 1


def test_its_order_is_the_formulas():
    """Two: Curtiss and Hirschfelder's formula of two steps; `test_integrators` measures it."""
    assert BDF2().order == 2
