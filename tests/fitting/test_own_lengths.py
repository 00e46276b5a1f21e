"""Lines of stiffening springs, converted to the lengths of the fitted knee: the same springs, and the line through what
they pull there."""

from __future__ import annotations

import numpy as np
import pytest
from small_scene import small_scene

import pftwin
from fitting.inference.nuisance_draws import at_own_lengths
from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.trials import free_in_trials, objective_of
from pftwin.model.measured import Measured

FREE = ("K1", "L1", "K2", "L2")


def problem(free: tuple[str, ...], nuisance: Nuisance) -> Problem:
    knee = small_scene()
    scenes, parameters = free_in_trials([knee], free, 0.3, None, nuisance)
    measured = Measured(knee.motion.times, np.zeros((knee.motion.times.size, 3)))
    target = objective_of(scenes, [measured], "likelihood", "position", None, "linear", {})
    return Problem.of(scenes, parameters, target)


@pytest.mark.slow
def test_draws_are_converted_to_lines_at_the_knees_lengths():
    """A knee with shorter tendons works at other lengths than the nominal one: another line, the same tensions."""
    nuisance = Nuisance(stiffening=0.2).at_work([small_scene()])
    one = problem(FREE, nuisance)
    theta = one.parameters.nominal * np.array([1.2, 0.75, 0.9, 0.95, 1.0, 1.2])
    draws = theta + np.array([[1.0], [0.0], [-1.0]]) * np.array([2.0, 1e-3, 5.0, 2e-4, 0.0, 0.0])
    own, converted = at_own_lengths(one, nuisance, draws)
    other = problem(FREE, own)
    before, after = (
        pftwin.simulate(p.parameters.apply(p.scene, row).set("quadriceps.damping", 0.0), dt=1e-3)
        for p, row in ((one, draws[1]), (other, converted[1]))
    )
    np.testing.assert_allclose(after.tensions["quadriceps"], before.tensions["quadriceps"], rtol=1e-9)
    slope, offset = np.polyfit(after.lengths["quadriceps"], after.tensions["quadriceps"], 1)
    assert converted[1, 0] == pytest.approx(slope, rel=3e-3)
    assert converted[1, 1] == pytest.approx(-offset / slope, rel=3e-3)
    assert draws[1, 0] > 1.05 * slope


def test_what_is_not_free_is_left_as_it_is():
    nuisance = Nuisance(stiffening=0.2).at_work([small_scene()])
    one = problem(("K1", "L2"), nuisance)
    draws = np.tile(one.parameters.nominal, (3, 1))
    own, converted = at_own_lengths(one, nuisance, draws)
    assert own is nuisance
    np.testing.assert_array_equal(converted, draws)


@pytest.mark.slow
def test_tendons_that_would_hang_slack_are_left_as_they_are():
    """So long that the knee's own lengths do not stretch them: the line there is no line."""
    nuisance = Nuisance(stiffening=0.2).at_work([small_scene()])
    one = problem(FREE, nuisance)
    draws = np.tile(one.parameters.nominal, (3, 1))
    draws[2, 1] = 0.3
    own, converted = at_own_lengths(one, nuisance, draws)
    np.testing.assert_array_equal(converted[:, :2], draws[:, :2])
    assert dict(own.working)["quadriceps"] == dict(nuisance.working)["quadriceps"]
    assert dict(own.working)["patellar_tendon"] != dict(nuisance.working)["patellar_tendon"]
