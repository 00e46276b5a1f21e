"""Springs that stiffen: the rig's own law, and the straight lines nearest to them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lifted_fits import HELD, scene
from small_scene import small_scene

import pftwin
from fitting.inference.knees import Knees
from fitting.methods.problem import Problem
from fitting.nuisance import EXACT
from fitting.stiffening import StiffeningSpring, Working, linear_tendons, stiffened
from fitting.trials import free_in_trials, objective_of
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.model.measured import Measured
from pftwin.rig.plant_parts import Spring


def test_a_stiffening_spring_is_the_rigs_own():
    """Against the plant of the rig, which shares no code with it; slope and energy by derivatives."""
    k, length, e = 173.0, 0.14, 0.08
    law = StiffeningSpring(jnp.asarray(k), jnp.asarray(4 * e / length))
    other = Spring(k, length, 0.0, np.zeros(3), np.zeros(3), e)
    for s in (0.004, 0.05, 0.12):
        at = law.at(jnp.asarray(s))
        assert float(at.force) == pytest.approx(other.force(length + s, 0.0), rel=1e-12)
        assert float(at.energy) == pytest.approx(other.energy(length + s), rel=1e-12)
        assert float(at.slope) == pytest.approx(float(jax.grad(lambda x: law.at(x).force)(jnp.asarray(s))), rel=1e-12)


def test_linear_tendons_offer_a_toe_region_and_others_do_not():
    scene = small_scene()
    assert linear_tendons(scene) == ("quadriceps", "patellar_tendon")
    assert linear_tendons(stiffened(scene, {"quadriceps": 0.05})) == ("patellar_tendon",)


def test_without_stiffening_the_scene_is_what_it_was():
    scene = small_scene()
    same = stiffened(scene, {"quadriceps": 0.0})
    one, other = (pftwin.simulate(s, dt=2e-3) for s in (scene, same))
    np.testing.assert_allclose(other.center, one.center, atol=1e-12)


@given(st.floats(0.02, 0.2), st.floats(0.1, 0.4), st.floats(0.0, 0.15), st.floats(0.05, 0.4), st.integers(0, 1000))
def test_the_line_nearest_to_a_bent_spring_is_the_one_asked_for(reach, rest, share, spread, seed):
    """By polynomial regression of the spring's forces at uneven lengths."""
    random = np.random.default_rng(seed)
    lengths = rest + reach * (1 + spread * (random.uniform(size=60) ** 2 - 0.3))
    k, own, e = Working.of(lengths).bent(np.array([173.0]), np.array([rest]), np.array([share]))
    spring = Spring(float(k[0]), float(own[0]), 0.0, np.zeros(3), np.zeros(3), float(e[0]))
    slope, offset = np.polyfit(lengths, [spring.force(x, 0.0) for x in lengths], 1)
    assert slope == pytest.approx(173.0, rel=1e-6)
    assert -offset / slope == pytest.approx(rest, rel=1e-6)


def test_a_tendon_that_hangs_slack_at_times_stays_straight():
    lengths = np.linspace(0.10, 0.14, 20)
    k, own, e = Working.of(lengths).bent(np.array([173.0, 173.0]), np.array([0.11, 0.09]), np.array([0.1, 0.1]))
    assert (k[0], own[0], e[0]) == (173.0, 0.11, 0.0)
    assert k[1] < 173.0


@pytest.mark.slow
def test_simulated_knees_stiffen_by_chance_and_keep_their_lines():
    """Against `simulate` of scenes that stiffen as much; lines through their tensions are those that were asked for."""
    knee, names = scene(HELD), ("K1", "L1", "K2", "L2")
    scenes, parameters = free_in_trials([knee], names, 0.3, None, EXACT)
    seen = Measured(knee.motion.times, np.zeros((knee.motion.times.size, 3)))
    target = objective_of([(scenes[0], seen)], "likelihood", "position", None, "linear", {})
    knees = Knees.of(Problem.of(scenes, parameters, target), 0.15, 16)
    assert [b.name for b in knees.bent] == ["quadriceps", "patellar_tendon"]
    theta = parameters[0].nominal * np.array([[1.0, 1.0, 1.0, 1.0], [1.2, 0.95, 0.85, 1.03]])
    found = knees.values(theta, 24, np.random.default_rng(5))
    shares = np.random.default_rng(5).uniform(0.0, 0.15, (2, 2))
    for row, share, values in zip(theta, shares, found.values, strict=True):
        own = parameters[0].apply(knee, row)
        bent, far = {}, 0.0
        for i, b in enumerate(knees.bent):
            k, rest, e = b.working.bent(*(np.array([x]) for x in (row[2 * i], row[2 * i + 1], share[i])))
            own = parameters[0].apply(own, [*parameters[0].vector(own)[: 2 * i], k[0], rest[0], *row[2 * i + 2 :]])
            bent[b.name], far = float(e[0]), max(far, float(e[0]))
        result = pftwin.simulate(stiffened(own, bent), dt=knee.motion.frame_interval / 24, integrator=LinearImplicit())
        np.testing.assert_allclose(values, result.center, atol=1e-7)
        assert far > 0.01
        for i, b in enumerate(knees.bent):
            taut = result.tensions[b.name] > 0
            slope, offset = np.polyfit(result.lengths[b.name][taut], result.tensions[b.name][taut], 1)
            assert slope == pytest.approx(row[2 * i], rel=0.05)
            assert -offset / slope == pytest.approx(row[2 * i + 1], rel=0.02)


def test_other_tendons_stay_as_they_are():
    """Those whose stiffness or slack length is not asked for; and all where nuisance is not."""
    knee = scene(HELD)
    scenes, parameters = free_in_trials([knee], ("K1", "L2"), 0.3, None, EXACT)
    seen = Measured(knee.motion.times, np.zeros((knee.motion.times.size, 3)))
    target = objective_of([(scenes[0], seen)], "likelihood", "position", None, "linear", {})
    problem = Problem.of(scenes, parameters, target)
    for most in (0.0, 0.1):
        assert Knees.of(problem, most, 16).bent == ()
        assert Knees.of(problem, most, 16).evaluator is problem.evaluator
