"""The energy account by closed forms: heat is what dashpots take, the rest what a step's own formula takes."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, RADIUS, G, J, contact, energies, gravity, order_of, record, state_at, system, tendon, vec

from pftwin.base.spatial import Quaternion, Twist, Wrench
from pftwin.dynamics.integrators import BDF2, LinearImplicit, Newmark
from pftwin.dynamics.ledger import Ledger, Powers
from pftwin.dynamics.state import State
from pftwin.model.effects.base import Drag, Load, StiffTerm
from pftwin.model.effects.contact_law import Hertz

K, SLACK, THROWN, DURATION = 200.0, 0.05, 0.004, 0.35
W = np.sqrt(K / MASS)


def _along(z: float):
    return vec(0.0, 0.0, z)


def swinging(damping: float, steps: int, integrator):
    """A weight let go above its rest on a taut tendon: what it has lost, heat and numerical dissipation [J].

    All since the first step, of which the account knows the end alone.
    """
    sys = system(gravity(), tendon(K, SLACK, damping))
    start = state_at(sys, (0, 0, 0.1 - SLACK - MASS * G / K + THROWN))
    states, ledger = record(sys, start, J(DURATION / steps), steps, integrator)
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, replace(states, solver_state=None))
    kinetic = np.asarray(jax.vmap(sys.kinetic_energy)(states))
    total = np.asarray(energies(sys, states))
    taken = np.asarray(ledger.done) - kinetic[1:]
    return tuple(a[1:] - a[0] for a in (-total[1:], np.asarray(ledger.heat), taken))


def test_backward_euler_takes_what_its_formula_says_and_none_of_it_is_heat():
    """Each step of an undamped swing divides its energy by 1 + (w h)^2 (Hairer and Wanner, section IV.3)."""
    steps = 350
    lost, heat, taken = swinging(0.0, steps, LinearImplicit())
    swing = 0.5 * K * THROWN**2
    remains = (1 + (W * DURATION / steps) ** 2) ** -np.arange(1.0, steps + 1)
    assert not heat.any()
    np.testing.assert_allclose(taken, swing * (remains[0] - remains[1:]), rtol=2e-3)
    np.testing.assert_allclose(taken, lost, rtol=0, atol=1e-14)


def test_the_average_acceleration_takes_nothing():
    lost, heat, taken = swinging(0.0, 350, Newmark())
    assert not heat.any()
    assert np.abs(taken).max() < 1e-12
    assert np.abs(lost).max() < 1e-12


@pytest.mark.parametrize("integrator", [LinearImplicit(), BDF2()], ids=lambda i: i.text)
def test_an_elastic_contact_makes_no_heat_however_it_opens_within_a_step(integrator):
    """A weight bounces on it in steps as long as the impact, which take much of its energy."""
    sys = system(gravity(), contact(Hertz(J(2e8))))
    states, ledger = record(sys, state_at(sys, (0, 0, RADIUS + 0.003)), J(1e-3), 100, integrator)
    assert np.count_nonzero(np.diff(np.sign(states.velocity.z))) >= 2
    assert not np.asarray(ledger.heat).any()


@pytest.mark.parametrize(("integrator", "order"), [(LinearImplicit(), 1), (BDF2(), 2)], ids=lambda x: str(x))
def test_heat_and_numerical_dissipation_converge_with_the_integrators_order(integrator, order):
    """A damped swing loses its energy as heat: E(0) - E(t) of the closed form, and the step's own share vanishes."""
    c, t = 1.2, DURATION
    d = c / (2 * MASS)
    w = np.sqrt(W**2 - d**2)
    x = THROWN * np.exp(-d * t) * (np.cos(w * t) + d / w * np.sin(w * t))
    v = -THROWN * np.exp(-d * t) * W**2 / w * np.sin(w * t)
    exact = 0.5 * K * THROWN**2 - 0.5 * K * x**2 - 0.5 * MASS * v**2
    errors, takes = [], []
    for steps in (350, 700, 1400, 2800):
        lost, heat, taken = swinging(c, steps, integrator)
        np.testing.assert_allclose(lost, heat + taken, rtol=0, atol=1e-14)  # the account closes to rounding
        assert np.all(np.diff(heat) >= 0)
        errors.append(abs(heat[-1] - exact))
        takes.append(abs(taken[-1]))
    assert errors[0] < 0.2 * exact
    assert np.all(order_of(errors) > order - 0.2)
    assert np.all(order_of(takes) > order - 0.2)


def test_a_medium_that_moves_does_work_and_a_known_pull_too():
    """A medium at 0.5 m/s drags a body at 0.2 by 3 N s/m: it puts in 0.45 W; 0.27 W are heat, 0.18 W the body gets."""
    medium, pull = 0.5, 2.0
    body = Twist(_along(0.2), _along(0.0))
    drag = Drag(J(3.0), J(0.0), _along(0.2 - medium), _along(0.0))
    powers = Powers.of([Load(drag=drag), Load(wrench=Wrench(_along(pull), _along(0.0)))], body, body)
    assert float(powers.work) == pytest.approx(0.45 + pull * 0.2)
    assert float(powers.heat) == pytest.approx(0.27)
    assert float(powers.lossy) == pytest.approx(0.18 + pull * 0.2)
    trial = Twist(_along(0.25), _along(0.0))  # the drag was computed at another velocity of the same medium
    other = eqx.tree_at(lambda d: d.velocity, drag, _along(0.25 - medium))
    for a, b in zip(
        Powers.of([Load(drag=other)], trial, body)[:3], Powers.of([Load(drag=drag)], body, body), strict=False
    ):
        assert float(a) == pytest.approx(float(b))


def test_the_fastest_approach_is_that_of_contacts_that_push_from_the_steps_start():
    """A term says how fast it closes at its trial velocity: 0.3 of 0.5 m/s, of which 0.4 there were."""
    nothing, z = _along(0.0), _along(1.0)
    push = StiffTerm(z, nothing, J(5.0), J(5.0), J(1e4), J(0.0), J(0.3), unilateral=True)
    none = eqx.tree_at(lambda t: (t.force, t.rate), push, (J(0.0), J(9.0)))
    tied = StiffTerm(z, nothing, J(5.0), J(5.0), J(1e4), J(0.0), J(9.0))
    before, after = (State(nothing, Quaternion.identity(), _along(v), nothing, ()) for v in (-0.4, -0.1))
    trial = Twist(_along(-0.5), nothing)
    ledger = Ledger.opened(J(0.0)).after_step(before, after, [Load(stiff=(push, none, tied))], J(1e-3), trial)
    assert float(ledger.approach) == pytest.approx(0.3 - 0.1)
    slower = eqx.tree_at(lambda t: t.rate, push, J(0.1))
    later = ledger.after_step(before, after, [Load(stiff=(slower,))], J(1e-3), trial)
    assert float(later.approach) == pytest.approx(0.2)


def test_powers_are_summed_by_trapezoids_and_potential_forces_along_the_displacement():
    """A weight that is carried down by 1, 2 and 3 mm in three steps: its own end velocities play no part in it."""
    weight = Load(wrench=Wrench(_along(-5.0), _along(0.0)), energy=J(0.0))
    ledger, at = Ledger.opened(J(0.0)), 0.0
    for k, fall in enumerate((1e-3, 2e-3, 3e-3)):
        before, after = (State(_along(z), Quaternion.identity(), _along(9.0), _along(0.0), ()) for z in (at, at - fall))
        pull = Load(wrench=Wrench(_along(float(k)), _along(0.0)))
        ledger, at = ledger.after_step(before, after, [weight, pull], J(1e-3)), at - fall
    assert float(ledger.work) == pytest.approx(1e-3 * 9.0 * (0 + 0.5 + 1.5))  # the first from its end alone
    assert float(ledger.done) == pytest.approx(5.0 * 6e-3 + float(ledger.work))
    assert float(ledger.heat) == 0.0
