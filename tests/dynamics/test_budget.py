"""A whole knee in motion: its energy budget closes, and its path converges, as the step goes to zero."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, knee, order_of, settled

from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.state import Guide, System
from pftwin.model.scene import Scene

DURATION = 0.2
COUNTS = (200, 400, 800, 1600)


@eqx.filter_jit
def journey(scene: Scene, start, count, integrator: Integrator):
    """Final position [mm], energies at start and end, and the ledger, after `count` (traced) steps."""
    sys, advance = System.of(scene), integrator.advance
    step = DURATION / count

    def guide_at(t):
        here, middle = Guide.sample(scene.motion, t), Guide.sample(scene.motion, t + 0.5 * step)
        return eqx.tree_at(lambda g: (g.tibia.velocity, g.tibia.angular_velocity), here,
                           (middle.tibia.velocity, middle.tibia.angular_velocity))  # fmt: skip

    def one(i, now):
        state, ledger, path = now
        state, ledger = advance(sys, state, lambda _: guide_at(step * i.astype(float)), step, ledger)
        return state, ledger, path + step * state.position.array()

    def energy(state, t):
        looks = Guide.sample(scene.motion, t).instant(state.patella(), 0.0)
        loads, _ = sys.loads(looks, state.memories)
        return sys.kinetic_energy(state) + sum(x.energy for x in loads if x.energy is not None)

    state, zero = sys.at_rest(start.pose, start.memories), jnp.zeros(())
    before = energy(state, zero)
    n = jnp.round(count).astype(int)
    state, ledger, path = jax.lax.fori_loop(0, n, one, (state, Ledger(zero, zero), jnp.zeros(3)))
    return 1e3 * state.position.array(), energy(state, zero + DURATION) - before, ledger, 1e3 * path / DURATION


@pytest.fixture(scope="module")
def journeys():
    scene = knee()
    start = settled(scene)
    assert bool(start.converged())
    return [journey(scene, start, J(float(n)), LinearImplicit()) for n in (*COUNTS, 25600)]


def test_the_energy_budget_closes(journeys):
    gaps = [float(change - ledger.work + ledger.heat) for _, change, ledger, _ in journeys]
    ledger = journeys[-1][2]
    assert float(ledger.work) > 5e-3  # joules: the tibia pulls the patella along
    assert float(ledger.heat) > 1e-4
    assert abs(gaps[0]) < 0.02 * float(ledger.work)
    # Left over is the step's own doing, of either sign: forces stand at its end, displacements in its middle.
    np.testing.assert_allclose(order_of(np.abs(gaps[:4])), 1, atol=0.3)


def test_the_path_converges_with_the_first_order(journeys):
    finest = np.asarray(journeys[-1][3])
    errors = [np.linalg.norm(np.asarray(j[3]) - finest) for j in journeys[:-1]]
    assert errors[0] < 0.05
    assert order_of(errors).mean() == pytest.approx(1, abs=0.25)
