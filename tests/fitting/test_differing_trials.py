"""Numbers that differ between trials: two of a small knee, whose patellar tendon is another length in each."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lifted_trials import BOUNDS, COMPUTED, FREE, MOVED, POINT, STEPS, nominal, problem_of
from made_estimates import made_estimate

import fitting
import pftwin
from fitting.cli.fit_options import deviations
from fitting.cli.report import tables
from fitting.cli.report.material import Material
from fitting.coverage import QUICK, SEVERAL_TRIALS, VARYING
from fitting.estimate import Estimate
from fitting.evaluation import Prediction
from fitting.fit import likelihood_of
from fitting.methods.problem import Problem, Request
from fitting.nuisance import EXACT
from fitting.objective import SPRINGS
from fitting.parameters import Parameters, weights_in
from fitting.trials import free_in_trials, objective_of
from fitting.trials_evaluator import TrialsEvaluator
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

STIFFNESS, LENGTHS = 1.1 * 156.0, (0.0728, 0.0735)
VARIES = {"L2": 1e-3}
NOISE = {"position": 1e-5}
POINTS = tuple(float(scene.get(POINT)) for scene in nominal())


@cache
def measured() -> tuple[Measured, Measured]:
    """Without noise, of one stiffness and two lengths."""
    found = []
    for scene, length, steps in zip(nominal(), LENGTHS, STEPS, strict=True):
        true = scene.set("K1", STIFFNESS).set("L2", length)
        step = scene.motion.frame_interval / steps
        result = pftwin.simulate(true, dt=step, integrator=pftwin.LinearImplicit())
        found.append(Measured(result.times, result.center))
    return found[0], found[1]


def fitted(**more: Any) -> Estimate:
    given = {"free": FREE, "bounds": BOUNDS, "noise": NOISE, "starts": 4, "varies": VARIES, "computed": COMPUTED}
    return fitting.fit_tendons(nominal(), measured(), **{**given, **more})


@cache
def found() -> Estimate:
    return fitted()


def problem(trials: tuple[int, ...], varies: dict[str, float] | None) -> Problem:
    return problem_of(trials, [measured()[i] for i in trials], NOISE, varies)


@pytest.mark.slow
def test_each_trial_has_its_own_length_and_their_mean_is_reported():
    """Measurements fix both lengths; of the mean of all trials two tell as much as two normal numbers of theirs."""
    assert found().names == (*FREE, "L2 difference in low", "L2 difference in high")
    estimates = found().in_trials["L2"]
    assert list(estimates) == ["low", "high"]
    np.testing.assert_allclose([value for value, _ in estimates.values()], LENGTHS, rtol=1e-5)
    np.testing.assert_allclose(found().values[:3], [STIFFNESS, 0.5 * sum(LENGTHS), POINTS[0]], rtol=1e-4, atol=1e-6)
    assert found().standard_deviations[1] == pytest.approx(VARIES["L2"] / np.sqrt(2), rel=0.01)
    assert found().in_trials["L2"]["low"][1] < 0.05 * VARIES["L2"]


@pytest.mark.slow
def test_without_it_neither_trial_fits():
    assert fitted(varies=None).rmse["position"] > 100 * found().rmse["position"]


@pytest.mark.slow
def test_value_gradient_and_information_are_those_of_the_trials_with_their_own_numbers():
    point = POINTS[0] + 0.001
    both = problem((0, 1), VARIES).normal(np.array([160.0, 0.0731, point, -0.0004, 0.0006]), 6)
    one = problem((0,), None).normal(np.array([160.0, 0.0727, point]), 6)
    other = problem((1,), None).normal(np.array([160.0, 0.0737, point + MOVED]), 5)
    first, second = (np.array([[1.0, 0, 0, 0, 0], [0, 1, 0, a, b], [0, 0, 1, 0, 0]]) for a, b in ((1, 0), (0, 1)))
    cost = 0.5 * (0.4**2 + 0.6**2)
    np.testing.assert_allclose(both.value, one.value + other.value + cost, rtol=1e-9)
    expected: Any = one.gradient @ first + other.gradient @ second + [0, 0, 0, -400.0, 600.0]
    np.testing.assert_allclose(both.gradient, expected, rtol=1e-8)
    prior = np.diag([0, 0, 0, 1e6, 1e6])
    information = first.T @ one.hessian[0] @ first + second.T @ other.hessian[0] @ second + prior
    np.testing.assert_allclose(both.hessian[0], information, rtol=1e-9, atol=1e-6 * np.abs(information).max())


@dataclass
class PredictedTrial:
    """What predicts a trial without a simulation: by a line and a parabola in each of the numbers that trials share."""

    parameters: Parameters
    scenes: tuple[Scene, ...]
    first: int  # steps between two frames
    seed: int
    computed, in_turns, slope_chunk = None, False, 1
    asked: list[int] = field(default_factory=list)  # steps between two frames

    def with_slopes(self, theta: np.ndarray, substeps: int) -> Prediction:
        self.asked.append(substeps)
        slope, curve = np.random.default_rng(self.seed).normal(size=(2, 41, 3, len(FREE)))
        u = self.parameters.share(theta)[:, None, None]
        slopes = (slope + 2 * curve * u) / (self.parameters.upper - self.parameters.lower)
        return Prediction(np.sum(slope * u + curve * u**2, axis=-1), slopes, np.ones(len(theta), bool))


def two_trials() -> tuple[Problem, list[PredictedTrial], list[Problem]]:
    """Of both trials, and what predicts each, and of each alone."""
    scenes, own = free_in_trials(nominal(), FREE, BOUNDS, None, EXACT, VARIES)
    evaluators = [PredictedTrial(p.shared, (s,), *n) for s, p, n in zip(scenes, own, ((6, 1), (5, 2)), strict=True)]
    data = [Measured(s.motion.times, np.random.default_rng(k).normal(size=(41, 3))) for k, s in enumerate(scenes)]
    both: Any = TrialsEvaluator(tuple(evaluators), own[0].differences)
    shared = [p.shared for p in own]
    targets = [
        objective_of(scenes[k], data[k], "likelihood", ("position",), {"position": 0.1}, "linear", SPRINGS)
        for k in (slice(0, 2), slice(0, 1), slice(1, 2))
    ]
    alone = [Problem(s, p, t, e) for s, p, t, e in zip(scenes, shared, targets[1:], evaluators, strict=True)]
    return Problem(scenes[0], own[0], targets[0], both), evaluators, alone


def test_gradient_and_value_are_those_of_trials_with_their_own_lengths_and_steps():
    """Of predictions by formulas: differences of the value, which two sides give exactly where it is a parabola."""
    both, evaluators, alone = two_trials()
    theta = np.array([160.0, 0.0731, POINTS[0] + 0.001, -0.0004, 0.0006])
    steps = np.diag([1e-2, 1e-6, 1e-6, 1e-6, 1e-6])
    ahead, behind = (both.normal(theta + side * steps, 12).value for side in (1, -1))
    found = both.normal(theta, 12)
    np.testing.assert_allclose(found.gradient[0], (ahead - behind) / 2 / np.diagonal(steps), rtol=1e-5)
    one, other = np.array([[160.0, 0.0727, theta[2]]]), np.array([[160.0, 0.0737, theta[2] + MOVED]])
    parts = alone[0].normal(one, 12), alone[1].normal(other, 10)
    cost = 0.5 * (0.4**2 + 0.6**2)
    np.testing.assert_allclose(found.value, parts[0].value + parts[1].value + cost, rtol=1e-9)
    assert [{*each.asked} for each in evaluators] == [{12}, {10}]


@pytest.mark.slow
def test_its_gradient_is_that_of_differences():
    both, theta = problem((0, 1), VARIES), np.array([160.0, 0.0731, POINTS[0] + 0.001, -0.0004, 0.0006])
    steps = np.diag([1e-3, 1e-7, 1e-7, 1e-7, 1e-7])
    ahead, behind = (both.normal(theta + side * steps, 6).value for side in (1, -1))
    quotients = (ahead - behind) / 2 / np.diagonal(steps)
    np.testing.assert_allclose(both.normal(theta, 6).gradient[0], quotients, rtol=1e-4)


@pytest.mark.slow
def test_a_plan_allows_for_what_differs():
    """What one trial tells of the mean: its covariance and that between trials, added; trials' informations add."""
    given: Any = {"free": FREE, "bounds": BOUNDS, "noise": {"position": 3e-4}, "candidates": []}
    plan = fitting.plan_experiment(nominal()[0], further=[nominal()[1]], varies={"L2": 0.4e-3}, **given)
    between = np.diag([0.0, 0.4e-3**2, 0.0])
    one, other = (fitting.plan_experiment(scene, **given).covariance + between for scene in nominal())
    size = np.array([156.0, 0.0714, 0.04])  # the coordinate's deviation is relative to its bounds' span
    np.testing.assert_allclose(plan.covariance / np.outer(size, size), one / np.outer(size, size), rtol=1e-5, atol=1e-8)
    parts = [np.linalg.inv(c / np.outer(size, size)) for c in (one, other)]
    np.testing.assert_allclose(plan.additions["trial high"], np.sqrt(np.diagonal(np.linalg.inv(sum(parts)))), rtol=1e-5)


@pytest.mark.slow
def test_reverse_mode_agrees_with_forward_mode():
    both, point = problem((0, 1), VARIES), POINTS[0]
    theta = np.array([[160.0, 0.0731, point + 0.001, -0.0004, 0.0006], [150.0, 0.072, point, 0.0, 1e-3]])
    reverse, forward = both.answer(Request(theta, 6, "gradient")), both.normal(theta, 6)
    scale = np.abs(forward.gradient).max(axis=0)
    np.testing.assert_allclose(reverse.gradient / scale, forward.gradient / scale, atol=1e-6)


@pytest.mark.slow
def test_fitted_scenes_have_their_own_numbers_and_others_those_that_are_shared():
    for scene, length in zip(found().scenes, LENGTHS, strict=True):
        assert float(scene.get("L2")) == pytest.approx(length, rel=1e-5)
        assert float(scene.get("K1")) == pytest.approx(STIFFNESS, rel=1e-5)
    elsewhere = found().apply(nominal()[1])
    assert float(elsewhere.get("L2")) == pytest.approx(np.mean(LENGTHS), rel=1e-4)


@pytest.mark.slow
def test_draws_for_other_knees_are_of_further_trials():
    """Between trials by 1 mm, of a mean known to 1 / sqrt(2) mm."""
    drawn = found().samples(4000, seed=3)
    assert drawn[:, 1].std() == pytest.approx(1e-3 * np.sqrt(1.5), rel=0.05)
    assert drawn[:, 1].mean() == pytest.approx(np.mean(LENGTHS), abs=1e-4)
    assert drawn[:, 0].std() == pytest.approx(found().standard_deviations[0], rel=0.05)
    learned = replace(found(), draws=np.tile(found().values, (50, 1))).samples(4000, seed=3)
    assert learned[:, 1].std() == pytest.approx(1e-3, rel=0.05)


@pytest.mark.slow
def test_a_file_holds_them(tmp_path):
    scenes = [replace(s, measured=m) for s, m in zip(nominal(), measured(), strict=True)]
    again = Estimate.load(found().save(tmp_path / "fit.json"), scenes)
    assert (again.in_trials, again.varies, again.shared) == (found().in_trials, VARIES, 3)
    assert float(again.scenes[1].get("L2")) == pytest.approx(LENGTHS[1], rel=1e-5)
    assert likelihood_of(again, None).normal(again.values[None]).value[0] == pytest.approx(again.objective_value)
    assert re.search(r"L2 in high: 0\.073[45]\d* \+- ", again.summary())


def test_numbers_of_many_trials_are_weighed_as_stated():
    """Of five parameters the fourth and the first differ, in three trials."""
    differences = ((3, 0), (3, 1), (3, 2), (0, 0), (0, 1), (0, 2))
    theta = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    for trial, (fourth, first) in enumerate([(4.1, 1.01), (4.2, 1.02), (4.3, 1.03)]):
        np.testing.assert_allclose(weights_in(differences, 5, trial) @ theta, [first, 2, 3, fourth, 5])


@pytest.mark.parametrize(
    ("varies", "trials", "said"),
    [
        ({"L2": 1e-3}, (0,), "varies: a single trial"),
        ({"L1": 1e-3}, (0, 1), "'L1' is not free"),
        ({"L2": 0.0}, (0, 1), "L2: found 0.0"),
        ({"K1": 40.0}, (0, 1), "K1: bounds 109.2 to 202.8 and 4 deviations of 40 leave room for"),
    ],
)
def test_what_cannot_vary_is_refused(varies, trials, said):
    with pytest.raises(InputError, match=said):
        free_in_trials([nominal()[i] for i in trials], FREE, BOUNDS, None, EXACT, varies)


def test_the_papers_objective_has_nothing_to_weigh_them_against():
    data = [Measured(s.motion.times, np.zeros((41, 3))) for s in nominal()]
    with pytest.raises(InputError, match="varies: the paper's objective has no noise"):
        fitting.fit_tendons(nominal(), data, free=FREE, bounds=BOUNDS, objective="paper", varies=VARIES)


def test_the_command_line_takes_them():
    assert deviations(["L2=1e-3", " contact.friction.coefficient = 0.01"], "--varies", "L1=5e-4") == {
        "L2": 1e-3,
        "contact.friction.coefficient": 0.01,
    }
    with pytest.raises(InputError, match="--varies: found 'L2'"):
        deviations(["L2"], "--varies", "L1=5e-4")
    with pytest.raises(InputError, match="--varies: 'L2' is given twice"):
        deviations(["L2=1e-3", "L2=2e-3"], "--varies", "L1=5e-4")


@pytest.mark.slow
def test_simulations_find_what_least_squares_find():
    """Where the model is right and noise is white: the same means, and deviations a little wider (networks).

    The noise is well above the errors of the simulations' steps, 0.1 mm here; a search halves them further.
    """
    random = np.random.default_rng(8)
    data = [replace(m, center=m.center + 4e-4 * random.normal(size=(41, 3))) for m in measured()]
    given: Any = {"free": ("K1", "L2"), "bounds": 0.2, "noise": {"position": 4e-4}, "varies": VARIES}
    quick = fitting.fit_tendons(nominal(), data, **given)
    learned = fitting.fit_tendons(nominal(), data, method="simulations", simulations=8000, rounds=4, **given)
    assert learned.names == quick.names
    assert (np.abs(learned.values - quick.values) / quick.standard_deviations).max() < 0.4
    wider = learned.standard_deviations / quick.standard_deviations
    assert (wider > 0.9).all()
    assert (wider < 1.4).all()


@pytest.mark.slow
def test_fewer_scenes_than_were_fitted_get_what_trials_share(tmp_path):
    again = Estimate.load(found().save(tmp_path / "fit.json"), nominal()[1])
    assert float(again.scene.get("L2")) == pytest.approx(0.5 * sum(LENGTHS), rel=1e-4)


@pytest.mark.slow
def test_a_report_tells_what_trials_share_and_each_trials_own():
    rows = {row[0]: row for row in tables.fitted(found(), nominal()[0]).rows}
    assert list(rows) == [*FREE, "L2 in low", "L2 in high"]
    assert rows["L2 in high"][2] == "73.5"  # [mm]
    assert Material(Path("fit.json"), "two trials").changed_since(found()) == []


def test_how_often_they_hold_was_not_measured():
    """docs/fitting.md, Limits: not by a search, not by simulations; of trials that share all, other words hold."""
    trials = {"low": {"position": 1e-4}, "high": {"position": 1e-4}}
    shared = made_estimate({"K1": (160.0, 4.0), "L2": (0.0715, 2e-4)}, trial_rmse=trials)
    for own in (shared, replace(shared, draws=np.tile(shared.values, (50, 1)))):
        coverage = replace(own, varies=VARIES).coverage
        assert coverage == VARYING
        assert "not measured" in coverage.intervals
        assert "%" not in "".join(coverage)
    assert shared.coverage == QUICK
    assert replace(shared, draws=np.tile(shared.values, (50, 1))).coverage == SEVERAL_TRIALS, VARYING


@pytest.mark.slow
def test_a_trained_posterior_knows_them(tmp_path):
    given: Any = {"free": ("K1", "L2"), "bounds": 0.2, "noise": {"position": 1e-4}, "varies": VARIES}
    random = np.random.default_rng(8)
    data = [replace(m, center=m.center + 1e-4 * random.normal(size=(41, 3))) for m in measured()]
    trained = fitting.train_posterior(nominal(), data, simulations=4000, **given)
    again = fitting.TrainedPosterior.load(trained.save(tmp_path / "t.npz"), nominal())
    assert again.set_up.varies == VARIES
    estimate = again.estimate(nominal(), data)
    assert estimate.varies == VARIES
    for length, (value, sd) in zip(LENGTHS, estimate.in_trials["L2"].values(), strict=True):
        assert abs(value - length) < 3 * sd
        assert sd < 0.5 * VARIES["L2"]
