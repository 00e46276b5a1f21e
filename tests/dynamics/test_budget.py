"""A whole knee in motion: its energy budget closes, and its path converges, as the step goes to zero."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, knee, order_of, settled

from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.observe import observe

FRAMES = 21  # 0.2 s
SUBSTEPS = (10, 20, 40, 80)
FINEST = 640


@eqx.filter_jit
def journey(scene, start, integrator, substeps):
    """The path [mm], and the account at all frames [J]: change of energy, work, heat, numerical dissipation."""
    path = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=True)
    seen, ledger = observe(scene, path), path.ledger
    total = sum(seen.potential_energy.values(), start=seen.kinetic_energy)
    account = (total - total[0], ledger.work, ledger.heat, ledger.numerical_dissipation(seen.kinetic_energy))
    return 1e3 * seen.center.array(), jnp.stack(account)


@pytest.fixture(scope="module", params=[LinearImplicit(), BDF2()], ids=lambda i: i.text)
def journeys(request):
    """The integrator's order, and journeys in ever shorter steps."""
    scene = knee(FRAMES)
    start = settled(scene)
    assert bool(start.converged())
    made = [journey(scene, start, request.param, J(n)) for n in (*SUBSTEPS, FINEST)]
    return request.param.order, [(np.asarray(path), np.asarray(account)) for path, account in made]


def test_the_energy_budget_closes(journeys):
    """Kinetic and stored energy, heat and numerical dissipation are the work: what is left is of the step's order."""
    order, made = journeys
    gaps = [np.abs(change - work + heat + taken).max() for _, (change, work, heat, taken) in made]
    most = np.abs(made[-1][1]).max(axis=1)
    assert most[1] > 5e-3  # joules: the tibia pulls the patella along
    assert most[2] > 1e-4
    assert gaps[0] < 1e-3 * most[1]
    assert np.log2(gaps[0] / gaps[3]) > 3 * (order - 0.2)


def test_heat_is_not_what_the_steps_take(journeys):
    """Heat is that of dashpots at any step; what the steps take, or give, falls with their order."""
    order, made = journeys
    heats, takes = (np.array([account[k, -1] for _, account in made]) for k in (2, 3))
    assert np.abs(heats[:4] / heats[4] - 1).max() < 0.01
    assert abs(takes[4]) < 1e-3 * heats[4]
    assert np.log2(np.abs(takes[:2]).max() / np.abs(takes[2:4]).max()) > 2 * (order - 0.3)


def test_the_path_converges(journeys):
    order, made = journeys
    errors = [np.sqrt(np.mean(np.sum((path - made[-1][0]) ** 2, axis=1))) for path, _ in made[:-1]]
    assert errors[0] < 0.05
    assert order_of(errors).mean() > order - 0.25
