"""The explicit step tells where it is beyond its limit of stability: a contact that chatters does not blow up."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, state_at, still_guide, system, vec

from pftwin.base.spatial import Vec3
from pftwin.dynamics.integrators.symplectic_euler import LIMIT, SymplecticEuler, _stiffest
from pftwin.model.effects.base import Load, StiffTerm
from pftwin.model.effects.tendon import Tendon

MASS, INERTIA = 0.12, (3e-5, 3e-5, 4e-5)


def pushing(direction, moment, stiffness, damping=0.0) -> StiffTerm:
    """A stiff term; leading axes as the stiffness has them."""
    k = J(stiffness)
    none = jnp.zeros_like(k)
    return StiffTerm(Vec3(*map(J, direction)), Vec3(*map(J, moment)), none, none, k, none + damping, none)


def largest(terms, step) -> float:
    """The largest eigenvalue of M^-1 sum (h^2 k + 2 h c) g g^T, of single terms."""
    root = 1 / np.sqrt([MASS] * 3 + list(INERTIA))
    total = np.zeros((6, 6))
    for t in terms:
        g = root * np.concatenate([t.direction.array(), t.moment.array()])
        total += float(step * (step * t.stiffness + 2 * t.damping)) * np.outer(g, g)
    return float(np.linalg.eigvalsh(total)[-1])


ONE = pushing((0.48, 0.6, 0.64), (0.01, 0.003, -0.002), 3e4, 5.0)
OTHER = pushing((0.8, 0.0, 0.6), (0.0, 0.01, 0.0), 1e4)


@pytest.mark.parametrize("terms", [(ONE,), (ONE, ONE)])
def test_the_largest_stiffness_of_unilateral_terms_is_exact(terms):
    step = J(4e-4)
    found = _stiffest(system(mass=MASS, inertia=INERTIA), [Load(stiff=terms)], step)
    assert float(found) == pytest.approx(largest(terms, step), rel=1e-12)


def test_a_group_is_its_terms():
    step, sys = J(4e-4), system(mass=MASS, inertia=INERTIA)
    group = pushing(([0.0, 0.8], [0.6, 0.0], [0.8, 0.6]), ([0.01, 0.0], [0.0, 0.01], [-0.002, 0.0]), [3e4, 1e4])
    single = [pushing((0.0, 0.6, 0.8), (0.01, 0.0, -0.002), 3e4), OTHER]
    together, apart = (_stiffest(sys, [Load(stiff=tuple(t))], step) for t in ([group], single))
    assert float(together) == pytest.approx(float(apart), rel=1e-12)
    assert 0.5 * largest(single, step) < float(apart) <= largest(single, step)


@pytest.mark.parametrize(("share", "flagged"), [(0.95, False), (1.05, True)])
def test_a_spring_is_flagged_if_its_oscillation_grows(share, flagged):
    """h^2 k = 4 m for a spring that pulls through the centre of mass."""
    stiffness = 4e3
    sys = system(Tendon(J(stiffness), J(0.05), J(0.0), vec(0, 0, 0), vec(0, 0, 0.1), body="ground", name="tendon"))
    step = J(share * np.sqrt(LIMIT * MASS / stiffness))
    method = SymplecticEuler()
    state = method.begin(sys, state_at(sys, (0, 0, 0.049)), still_guide(), step)
    after, _ = method.advance(sys, state, lambda _: still_guide(), step, None)
    before, now = method.diagnostics(state).residual, method.diagnostics(after).residual
    assert before is not None
    assert now is not None
    assert float(before) == 0
    assert (float(now) > 0) == flagged


def test_one_step_is_the_pull_and_its_moment_on_the_free_body():
    """v = h F / m and w = h I^-1 (r x F), from rest, for a spring that pulls beside the centre of mass."""
    stiffness, slack, insertion, origin = 4e3, 0.05, np.array([0.01, -0.02, 0.005]), np.array([0.03, 0.01, 0.1])
    sys = system(Tendon(J(stiffness), J(slack), J(0.0), vec(*insertion), vec(*origin), body="ground", name="tendon"))
    way = origin - insertion
    force = stiffness * (np.linalg.norm(way) - slack) * way / np.linalg.norm(way)
    step, method = 1e-4, SymplecticEuler()
    state = method.begin(sys, state_at(sys, (0, 0, 0)), still_guide(), J(step))
    after, _ = method.advance(sys, state, lambda _: still_guide(), J(step), None)
    np.testing.assert_allclose(after.velocity.array(), step * force / MASS, rtol=1e-9)
    np.testing.assert_allclose(after.spin.array(), step * np.cross(insertion, force) / np.array(INERTIA), rtol=1e-9)


def test_its_order_is_eulers():
    assert SymplecticEuler().order == 1
