"""Motion with a closed form: free fall, a damped oscillator, a free top, a pendulum. Orders are measured."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scenes import (
    MASS,
    G,
    J,
    gravity,
    march,
    order_of,
    oscillator_errors,
    record,
    state_at,
    still_guide,
    system,
    tendon,
)
from scipy.special import ellipk

from pftwin.dynamics.integrators import LinearImplicit, SymplecticEuler

INTEGRATORS = pytest.mark.parametrize("integrator", [LinearImplicit(), SymplecticEuler()], ids=lambda i: i.text)
STEPS = (800, 1600, 3200, 6400)


@INTEGRATORS
def test_free_fall(integrator):
    falling = system(gravity())
    start = state_at(falling, (0, 0, 1), velocity=(0.5, 0, 0))
    h, t = 1e-3, 0.2
    end = march(falling, start, t, 200, integrator)
    assert float(end.velocity.z) == pytest.approx(-G * t, rel=1e-12)
    assert float(end.position.x) == pytest.approx(0.5 * t, rel=1e-12)
    assert float(end.position.z) == pytest.approx(1 - 0.5 * G * t * (t + h), rel=1e-12)  # Euler's own half step late


@INTEGRATORS
def test_damped_oscillator_on_a_tendon(integrator):
    """First order in the step, over long counts of steps."""
    errors, x0 = oscillator_errors(STEPS, integrator)
    assert errors[0] < 0.05 * x0
    np.testing.assert_allclose(order_of(errors), 1, atol=0.1)
    declared = integrator.order
    assert round(float(order_of(errors)[-1])) == declared


def test_a_free_top_keeps_energy_and_angular_momentum():
    inertia = np.array([2e-5, 5e-5, 8e-5])
    top = system(inertia=inertia)
    start = state_at(top, (0, 0, 0), spin=(0.3, 12.0, 0.2))  # about the unstable middle axis: it tumbles

    def conserved(state):
        spin = np.asarray(state.spin.array())
        momentum = np.asarray(state.orientation.rotation().array()) @ (inertia * spin)
        return 0.5 * np.sum(inertia * spin**2), momentum

    e0, l0 = conserved(start)
    ends = [march(top, start, 1.0, 3 * n) for n in STEPS]
    assert float(ends[-1].spin.y) < 0  # it has turned over
    drift = [conserved(e) for e in ends]
    energy = [abs(e - e0) / e0 for e, _ in drift]
    momentum = [np.linalg.norm(turning - l0) / np.linalg.norm(l0) for _, turning in drift]
    assert energy[-1] < 1e-3
    assert momentum[-1] < 1e-3
    np.testing.assert_allclose(order_of(energy), 1, atol=0.25)
    np.testing.assert_allclose(order_of(momentum), 1, atol=0.25)


STIFFNESSES = (1e2, 1e3, 1e4, 1e5, 5e5)


@pytest.fixture(scope="module")
def pendulums():
    """Swings of 4 s on tendons from soft to stiffer than a real patellar tendon, at 1 ms."""
    amplitude, length = 0.4, 0.2
    at = (length * np.sin(amplitude), 0.0, 0.1 - length * np.cos(amplitude))

    def swing(k):
        slack = length - MASS * G * np.cos(amplitude) / k  # in balance along the rod when let go
        rod = tendon(k, slack)
        sys = system(gravity(), rod)
        states, _ = record(sys, state_at(sys, at), J(1e-3), 4000)
        stretch = jax.vmap(lambda s: rod.line(still_guide().instant(s.patella(), 0.0)).length)(states)
        return states.position.array(), stretch

    positions, lengths = jax.jit(jax.vmap(swing))(J(STIFFNESSES))
    return amplitude, length, np.asarray(positions), np.asarray(lengths)


def test_pendulums_of_any_stiffness_are_stable(pendulums):
    amplitude, length, positions, lengths = pendulums
    assert np.all(np.isfinite(positions))
    for x, rod, k in zip(positions, lengths, STIFFNESSES, strict=True):
        assert np.abs(x[:, 0]).max() < 1.05 * length * np.sin(amplitude) + 3 * MASS * G / k
        sag = MASS * G * (3 - 2 * np.cos(amplitude)) / k  # at the bottom, centripetal force included
        assert np.abs(rod - length).max() < 2.5 * sag + 1e-6
        np.testing.assert_allclose(x[:, 1], 0, atol=1e-15)


def test_period_of_a_pendulum_on_a_stiff_tendon(pendulums):
    amplitude, length, positions, _ = pendulums
    exact = 4 * np.sqrt(length / G) * ellipk(np.sin(amplitude / 2) ** 2)
    t = 1e-3 * np.arange(1, 4001)
    for x, k in zip(positions[:, :, 0], STIFFNESSES, strict=True):
        if k < 1e4:
            continue  # a soft tendon's pendulum stretches, and has no such period
        down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
        crossings = t[down] + 1e-3 * x[down] / (x[down] - x[down + 1])
        assert float(np.mean(np.diff(crossings))) == pytest.approx(exact, rel=2e-3)
