"""Stable or not, of forces without a potential: eigenvalues tell, and the symmetric part does not."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import march, state_at, system

from pftwin.base.spatial import Scalar, Vec3, Wrench
from pftwin.dynamics.quasi_static.newton import NEUTRAL, is_stable
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.model.effects.base import Effect, Instant, Load
from pftwin.model.effects.damping import LinearDamping

J = jnp.asarray
_stable = jax.jit(is_stable)


def tangent(block, others=(500.0, 2e3, 6e4, 1.5e6)) -> jax.Array:
    """(6, 6) with a block of two rows, the rest on the diagonal [N/m]."""
    k = np.diag([0.0, 0.0, *others])
    k[:2, :2] = block
    turned = np.linalg.qr(np.random.default_rng(3).normal(size=(6, 6)))[0]  # pivots are to be no eigenvalues
    return J(turned @ k @ turned.T)


@pytest.mark.parametrize(
    ("block", "wanted"),
    [
        ([[300, 0], [0, 400]], True),
        ([[300, 2e3], [0, 400]], True),  # its symmetric part has an eigenvalue of -650
        ([[300, -2e3], [2e3, -100]], True),  # a spiral that comes to rest
        ([[300, 2e3], [2e3, 400]], False),  # a saddle: a fold has been passed
        ([[100, -2e3], [2e3, -300]], False),  # a spiral that grows
        ([[0, 0], [0, 400]], True),  # neutral
        ([[-20, 2e3], [0, 400]], False),
    ],
)
def test_eigenvalues_tell(block, wanted):
    assert bool(_stable(tangent(block))) == wanted


def test_agrees_with_eigenvalues_at_random():
    """Stiffnesses over five decades, along directions that are not perpendicular."""
    rng = np.random.default_rng(0)
    found, wanted = [], []
    while len(found) < 300:
        values = 10 ** rng.uniform(1.5, 6.2, 6) * rng.choice([1, -1], 6, p=[0.9, 0.1])
        along = np.linalg.qr(rng.normal(size=(6, 6)))[0] + 0.3 * rng.normal(size=(6, 6))
        k = along @ np.diag(values) @ np.linalg.inv(along)
        least, trace = values.min(), values.sum()
        if trace > 0 and abs(least) > 3 * NEUTRAL * trace:
            found.append(bool(_stable(J(k))))
            wanted.append(least > 0)
    assert found == wanted
    assert 50 < sum(wanted) < 250


class Sheared(Effect):
    """f = -(k x + a y, k y, k z): no potential has it, and it leads home."""

    stiffness: Scalar  # k [N/m]
    shear: Scalar  # a [N/m]

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """At the centre of mass."""
        p = now.patella.position
        force = -self.stiffness * p - Vec3(self.shear * p.y, 0.0 * p.y, 0.0 * p.y)
        return Load(wrench=Wrench(force, Vec3(0.0 * p.x, 0.0 * p.x, 0.0 * p.x))), memory


def test_motion_under_forces_without_a_potential_has_no_snap():
    """In a viscous medium it comes home as x = e^(-k t / c) (x0 - a t / c y0), without a snap."""
    k, a, c, y0, duration = 200.0, 1500.0, 20.0, 0.004, 0.2
    medium = LinearDamping(J(c), J(1e-3), "ground")
    sheared = system(Sheared(J(k), J(a), name="sheared"), medium)
    end = march(sheared, state_at(sheared, (0, y0, 0)), duration, 400, QuasiStatic())
    left = np.exp(-k * duration / c)
    np.testing.assert_allclose(float(end.position.y), left * y0, rtol=1e-3)
    np.testing.assert_allclose(float(end.position.x), -left * a * duration / c * y0, rtol=1e-3)
    assert float(end.solver_state.snaps) == 0
