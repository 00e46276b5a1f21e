"""A button dropped on a flat patch: Hertz's closed forms, restitution against scipy, and coming to rest."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, RADIUS, G, J, contact, energies, gravity, march, order_of, record, state_at, system
from scipy.integrate import solve_ivp

from pftwin.dynamics.integrators import LinearImplicit, SymplecticEuler
from pftwin.model.effects.contact_law import Flores, Hertz, HuntCrossley

K, V0 = 2e8, 0.2
FLORES = "flores"


def impact(law, v0: float, duration: float, steps: int, height: float = 1e-5, integrator=LinearImplicit()):
    """The velocity with which a button thrown down from `height` above touch comes back."""
    sys = system(contact(law))
    start = state_at(sys, (0, 0, RADIUS + height), (0, 0, -v0))
    return float(march(sys, start, duration, steps, integrator).velocity.z)


def restitution_by_scipy(factor, v0: float = V0) -> float:
    """v_out / v_in of m d'' = -k d^1.5 (1 + factor d'), integrated to 1e-10."""

    def rhs(_, y):
        d, rate = y
        return [rate, -K / MASS * max(d, 0.0) ** 1.5 * max(1 + factor * rate, 0.0)]

    def apart(t, y):
        return y[0] if t > 1e-6 else 1.0

    apart.terminal, apart.direction = True, -1  # type: ignore[attr-defined]
    out = solve_ivp(rhs, (0, 1), [0.0, v0], events=apart, rtol=1e-10, atol=1e-14, max_step=1e-4)
    return -out.y[1, -1] / v0


@pytest.mark.parametrize("integrator", [LinearImplicit(), SymplecticEuler()], ids=lambda i: i.text)
def test_hertz_impact_has_its_depth_duration_and_bounce(integrator):
    """d_max = (5 m v0^2 / 4 k)^(2/5), T = 2.9432 d_max / v0 (Johnson 1985, sec. 11.4)."""
    sys = system(contact(Hertz(J(K))))
    start = state_at(sys, (0, 0, RADIUS), (0, 0, -V0))
    deepest = (5 * MASS * V0**2 / (4 * K)) ** 0.4
    duration = 2.9432 * deepest / V0
    n = 4000
    states, _ = record(sys, start, J(1.2 * duration / n), n, integrator)
    depth = RADIUS - np.asarray(states.position.z)
    assert depth.max() == pytest.approx(deepest, rel=2e-3)
    assert np.count_nonzero(depth > 0) * 1.2 / n == pytest.approx(1, rel=3e-3)
    assert float(states.velocity.z[-1]) == pytest.approx(V0, rel=3e-3)


@pytest.mark.parametrize("e", [0.3, 0.6, 0.9, 1.0])
def test_restitution_of_the_flores_law(e):
    reference = restitution_by_scipy(8 * (1 - e) / (5 * e * V0))
    out = impact(Flores(J(K), J(e)), V0, 2.5e-3, 20000)
    assert out / V0 == pytest.approx(reference, abs=2e-3)
    assert out / V0 == pytest.approx(e, abs=0.07)  # Flores et al. 2011: near e, over the whole range


def test_restitution_of_the_hunt_crossley_law():
    alpha = 0.5
    out = impact(HuntCrossley(J(K), J(alpha)), V0, 2.5e-3, 20000)
    assert out / V0 == pytest.approx(restitution_by_scipy(1.5 * alpha), abs=2e-3)
    assert out / V0 == pytest.approx(1 - alpha * V0, abs=0.02)


def test_slow_touch_loses_what_the_floor_says():
    v0 = 0.002
    law = Flores(J(K), J(0.6), approach_speed_floor=0.01)
    out = impact(law, v0, 0.01, 20000, height=1e-7)
    assert out / v0 == pytest.approx(restitution_by_scipy(8 * 0.4 / (5 * 0.6 * 0.01), v0), abs=5e-3)


@pytest.mark.parametrize("integrator", [LinearImplicit(), SymplecticEuler()], ids=lambda i: i.text)
def test_an_impact_converges_with_the_first_order(integrator):
    """Depth and rate shortly after the deepest point, against scipy."""
    factor, t = 8 * 0.4 / (5 * 0.6 * V0), 5e-4
    exact = solve_ivp(lambda _, y: [y[1], -K / MASS * y[0] ** 1.5 * (1 + factor * y[1])], (0, t), [0.0, V0],
                      rtol=1e-12, atol=1e-16).y[:, -1]  # fmt: skip
    sys = system(contact(Flores(J(K), J(0.6))))
    start = state_at(sys, (0, 0, RADIUS), (0, 0, -V0))
    ends = [march(sys, start, t, n, integrator) for n in (500, 1000, 2000, 4000)]
    depth = [abs(RADIUS - float(e.position.z) - exact[0]) for e in ends]
    rate = [abs(-float(e.velocity.z) - exact[1]) for e in ends]
    assert rate[-1] < 1e-3 * V0
    np.testing.assert_allclose(order_of(depth), 1, atol=0.1)
    np.testing.assert_allclose(order_of(rate), 1, atol=0.1)


def drop(law, height: float, seconds: float, step: float, offset: float = 0.0):
    sys = system(gravity(), contact(law))
    start = state_at(sys, (0, 0, RADIUS + height), (offset, 0, 0))
    states, ledger = record(sys, start, J(step), round(seconds / step))
    return np.asarray(states.position.z) - RADIUS, states, ledger, sys


def test_height_of_the_first_rebound():
    """Height times restitution squared, once the steps resolve the impact (0.6 ms long) well: here 1 us."""
    height, e = 0.02, 0.6
    v0 = np.sqrt(2 * G * height)
    back = restitution_by_scipy(8 * (1 - e) / (5 * e * v0), v0)
    fall = np.sqrt(2 * height / G)
    sys = system(gravity(), contact(Flores(J(K), J(e))))
    apex = march(sys, state_at(sys, (0, 0, RADIUS + height)), fall * (1 + back) + 5e-4, 100_000)
    assert float(apex.position.z) - RADIUS == pytest.approx(back**2 * height, rel=0.03)


@pytest.mark.parametrize("step", [1e-3, 2e-4])
def test_it_bounces_to_rest_and_stays_there(step):
    z, states, _, _ = drop(Flores(J(K), J(0.6)), 0.02, 1.0, step)
    sunk = (MASS * G / K) ** (2 / 3)
    assert z[-1] == pytest.approx(-sunk, rel=1e-6)
    assert float(states.velocity.norm()[-1]) < 1e-9
    assert z.min() > -0.05 * RADIUS


def test_no_bounce_gains_height_whatever_the_step_and_the_phase():
    """Lossless contact at 1 ms: stiff or soft, from 64 heights, the coarse step may lose energy but makes none."""
    heights = jnp.linspace(1e-3, 0.03, 64)

    def highest_after_touch(height, k, step):
        sys = system(gravity(), contact(Hertz(k)))
        start = state_at(sys, (0, 0, RADIUS + height))
        states, _ = record(sys, start, step, 400)
        z = states.position.z - RADIUS
        touched = jnp.cumsum(z < 0) > 0
        leaves = touched & (z > 0)
        return jnp.max(jnp.where(leaves, z, 0.0)) / height

    run = jax.jit(jax.vmap(highest_after_touch, (0, None, None)))
    for k in (1e5, 1e6, 1e7, 2e8, 1e10):
        gain = np.asarray(run(heights, J(k), J(1e-3)))
        assert gain.max() < 1


def test_nothing_is_created_at_rest():
    """A thousand steps on the spot: kinetic plus potential energy stays what it was."""
    z, states, _, sys = drop(Flores(J(K), J(0.6)), -((MASS * G / K) ** (2 / 3)), 1.0, 1e-3)
    total = np.asarray(energies(sys, states))
    assert np.ptp(z) < 1e-12
    assert np.ptp(total) < 1e-13


def test_the_answer_has_no_jumps_where_a_step_just_misses_the_touch():
    """A fitted parameter moves the phase of the steps: the path at 1 ms follows it continuously all the same."""
    heights = jnp.linspace(2e-3, 3e-3, 1001)  # 1 um apart; falls by 0.2 mm within a step

    def after_impact(height):
        sys = system(gravity(), contact(Hertz(J(1e6))))
        states, _ = record(sys, state_at(sys, (0, 0, RADIUS + height)), J(1e-3), 40)
        return states.position.z[-1]

    z = np.asarray(jax.jit(jax.vmap(after_impact))(heights))
    assert np.ptp(z) > 1e-4
    assert np.abs(np.diff(z)).max() < 2e-5
