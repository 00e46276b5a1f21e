"""Kinetic energy: half the mass times the speed squared, and half of the spin with the inertia."""

from __future__ import annotations

import pytest
from scenes import state_at, system


def test_it_is_that_of_each_velocity_and_spin():
    still = (0.0, 0.0, 0.0)
    bodies = system(mass=0.13, inertia=(2e-5, 5e-5, 8e-5))
    for axis, (inertia, rate) in enumerate(((2e-5, 3.0), (5e-5, -7.0), (8e-5, 11.0))):
        spin = tuple(rate if k == axis else 0.0 for k in range(3))
        turning = float(bodies.kinetic_energy(state_at(bodies, (1, 2, 3), velocity=still, spin=spin)))
        assert turning == pytest.approx(0.5 * inertia * rate**2, rel=1e-12)
    moving = float(bodies.kinetic_energy(state_at(bodies, (1, 2, 3), velocity=(2.0, -3.0, 6.0), spin=still)))
    assert moving == pytest.approx(0.5 * 0.13 * 49.0, rel=1e-12)
