"""Several trials of one knee, fitted together: shared parameters, offsets of points, channels that one trial lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from lifted_trials import BOUNDS, COMPUTED, FREE, MOVED, POINT, STEPS, alike, nominal, problem_of
from small_scene import small_scene

import fitting
import pftwin
from fitting.estimate import Estimate
from fitting.fit import likelihood_of
from fitting.inference.recordings import Noise
from fitting.methods.problem import Problem, Request
from fitting.nuisance import EXACT
from fitting.objective import Objective
from fitting.parameters import free_parameters
from fitting.trials import free_in_trials, joined_objective, rows_of_trials, trial_names
from fitting.uncertainty import long_run_score
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

OFF = 0.0017  # by how much it is elsewhere than the scenes say, in both [m]
STIFFNESS, LENGTH = 1.1 * 156.0, 1.02 * 0.0714
NOISE = {"position": 1e-4, "quadriceps": 0.05}


def true(scene: Scene) -> Scene:
    point = float(scene.get(POINT)) + OFF
    return scene.set("K1", STIFFNESS).set("L2", LENGTH).set(POINT, point)


def measured() -> tuple[Measured, Measured]:
    return measured_in(nominal)


def measured_alike() -> tuple[Measured, Measured]:
    return measured_in(alike)


@cache
def measured_in(trials: Callable[[], tuple[Scene, Scene]]) -> tuple[Measured, Measured]:
    """Positions of both, without noise; the quadriceps' force of the second alone, without some frames."""
    recorded = []
    for scene, steps in zip(trials(), STEPS if trials is nominal else 2 * STEPS[:1], strict=True):
        step = scene.motion.frame_interval / steps
        result = pftwin.simulate(true(scene), dt=step, integrator=pftwin.LinearImplicit())
        recorded.append((result.times, result.center, np.array(result.tensions["quadriceps"])))
    (times, center, _), (later, elsewhere, force) = recorded
    force[7:11] = np.nan
    return Measured(times, center), Measured(later, elsewhere, femoral_spring_force=force, source="the laboratory")


@cache
def together() -> Estimate:
    return fitted(alike(), measured_alike())


def fitted(scenes: Any, data: Any, **more: Any) -> Estimate:
    given = {"free": FREE, "bounds": BOUNDS, "use": COMPUTED, "noise": NOISE, "starts": 4}
    return fitting.fit_tendons(scenes, data, **{**given, **more})


@pytest.mark.slow
def test_what_both_trials_share_is_found():
    found = together()
    assert found.reason == "converged"
    point = float(nominal()[0].get(POINT))  # values are those of the first trial
    np.testing.assert_allclose(found.values, [STIFFNESS, LENGTH, point + OFF], rtol=1e-6)
    assert found.nominal[2] == pytest.approx(point)


def test_the_fitted_scenes_are_the_true_ones():
    for scene, other in zip(together().scenes, alike(), strict=True):
        for name in FREE:
            assert float(scene.get(name)) == pytest.approx(float(true(other).get(name)), rel=1e-6)


def problem(trials: tuple[int, ...], use: tuple[str, ...]) -> Problem:
    return problem_of(trials, [measured()[i] for i in trials], {channel: NOISE[channel] for channel in use})


@pytest.mark.slow
def test_values_gradients_and_information_add():
    """Of independent trials, whose insertion is elsewhere by as much as in the joint problem."""
    theta = np.array([160.0, 0.0705, float(nominal()[0].get(POINT)) + 0.001])
    both = problem((0, 1), COMPUTED).normal(theta, 6)
    one = problem((0,), ("position",)).normal(theta, 6)
    other = problem((1,), COMPUTED).normal(theta + np.array([0, 0, MOVED]), 5)
    for joint, first, second in zip(both, one, other, strict=True):
        np.testing.assert_allclose(joint, first + second, rtol=1e-9)
        assert (np.abs(first) > 0.01 * np.abs(joint)).any()
        assert (np.abs(second) > 0.01 * np.abs(joint)).any()


@pytest.mark.slow
def test_reverse_mode_agrees_with_forward_mode():
    both, point = problem((0, 1), ("position",)), float(nominal()[0].get(POINT))
    theta = np.array([[160.0, 0.0705, point + 0.001], [150.0, 0.0722, point - 0.002]])
    reverse, forward = (both.answer(Request(theta, 6, want)) for want in ("gradient", "normal"))
    np.testing.assert_allclose(reverse.value, forward.value, rtol=1e-9)
    scale = np.abs(forward.gradient).max(axis=0)
    np.testing.assert_allclose(reverse.gradient / scale, forward.gradient / scale, atol=1e-6)


@pytest.mark.slow
def test_a_plan_tells_what_a_further_trial_brings():
    """Its information added, of the same channels at the same noise, without measurements."""
    one, other = nominal()
    given: Any = {"free": FREE, "bounds": BOUNDS, "noise": {"position": 3e-4, "quadriceps": 0.2}}
    plan = fitting.plan_experiment(one, candidates=["quadriceps"], further=[other], **given)
    alone, elsewhere = (fitting.plan_experiment(scene, candidates=[], **given).covariance for scene in nominal())
    size = np.array([156.0, 0.0714, 0.04])  # the coordinate's deviation is relative to its bounds' span
    parts = [np.linalg.inv(c / np.outer(size, size)) for c in (alone, elsewhere)]
    np.testing.assert_allclose(plan.additions["trial high"], np.sqrt(np.diagonal(np.linalg.inv(sum(parts)))), rtol=1e-6)
    assert plan.trials == ("trial high",)
    assert plan.additions.keys() == {"trial high", "quadriceps"}


def test_each_trial_tells_what_is_left_of_it():
    found = together()
    assert found.scene_name == "low + high"
    assert found.trial_rmse.keys() == {"low", "high"}
    assert "quadriceps" not in found.trial_rmse["low"]
    assert found.trial_rmse["high"]["quadriceps"] < 1e-3
    assert any(remark.startswith("residual of position: ") and " in high" in remark for remark in found.remarks())


def test_the_likelihood_of_an_estimate_is_that_of_all_trials():
    found = likelihood_of(together(), None)
    assert found.objective.present.sum() == 41 * 3 + 41 * 3 + 37
    beside = together().values + np.array([[1.0, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]])
    values = found.normal(np.concatenate([together().values[None], beside])).value
    assert values[0] == pytest.approx(together().objective_value, rel=1e-6)
    assert (values[1:] > values[0] + 0.5).all()


@pytest.mark.slow
def test_simulations_take_trials_and_nuisance():
    random = np.random.default_rng(8)
    data = [replace(m, center=m.center + NOISE["position"] * random.normal(size=(41, 3))) for m in measured()]
    more: Any = {"free": ("K1", "L2"), "bounds": 0.2, "use": "position", "noise": {"position": NOISE["position"]}}
    simulated = {"method": "simulations", "simulations": 2000, "rounds": 4, "nuisance": "attachments=0.001"}
    found = fitting.fit_tendons(nominal(), data, **more, **simulated)
    assert np.abs((found.values[:2] - [STIFFNESS, LENGTH]) / found.standard_deviations[:2]).max() < 4
    assert len(found.auxiliary) == 12
    assert found.trial_rmse.keys() == {"low", "high"}
    assert max(left["position"] for left in found.trial_rmse.values()) < 3 * NOISE["position"]


def test_every_trial_is_drawn(tmp_path):
    files = {path.name for path in together().plot.save(tmp_path / "fit")}
    assert {"fit_fit.png", "fit_fit_2.png"} <= files
    with pytest.raises(InputError, match="no trial 3"):
        together().plot.fit(3)


def made(frames: int, channels: tuple[str, ...], seed: int) -> Objective:
    """Of distinct numbers; columns are those of the channels, without orientations."""
    widths = [3 if c == "position" else 1 for c in channels]
    data, noise = np.random.default_rng(seed).normal(size=(frames, sum(widths))), dict.fromkeys(channels, 0.1 * seed)
    there, of = np.ones(data.shape, bool), np.repeat(np.arange(len(channels)), widths)
    return Objective("likelihood", channels, data, there, channels, of, noise, "linear", seed == 1, f"trial {seed}")


def test_channels_that_a_trial_lacks_are_missing_there():
    one, other = made(5, ("quadriceps",), 1), made(3, ("position", "contact"), 2)
    whole = joined_objective([one, other])
    assert whole.channels == ("position", "quadriceps", "contact")
    assert whole.frames == rows_of_trials([5, 3]) == (slice(0, 5), slice(6, 9))
    np.testing.assert_array_equal(whole.measured[:5, 3], one.measured[:, 0])
    np.testing.assert_array_equal(whole.measured[6:], np.insert(other.measured, 3, np.nan, axis=1))
    expected = np.zeros((9, 5), bool)
    expected[:5, 3], expected[6:, :3], expected[6:, 4] = True, True, True
    np.testing.assert_array_equal(whole.present, expected)
    assert (whole.synthetic, whole.source) == (True, "trial 1; trial 2")
    assert whole.noise == {"quadriceps": 0.1, "position": 0.2, "contact": 0.2}
    values = np.random.default_rng(3).normal(size=(1, 9, 5))
    parts = [trial.residuals(values[:, rows]) for trial, rows in zip(whole.trials, whole.frames, strict=True)]
    np.testing.assert_array_equal(parts[1][0, :, [0, 1, 2, 4]].T, values[0, 6:, [0, 1, 2, 4]].T - other.measured)
    assert (whole.residuals(values)[0, 5] == 0).all()


def test_priors_and_bounds_are_the_firsts_and_move_with_coordinates():
    """The second trial's point lies beyond the bounds of the first's."""
    point = float(nominal()[0].get(POINT))
    bounds = {**BOUNDS, POINT: (point - 0.002, point + 0.001)}
    priors = {POINT: (point + 0.0004, 0.001), "K1": (150.0, 9.0)}
    first, second = free_in_trials(nominal(), FREE, bounds, priors, EXACT)[1]
    assert first == free_parameters(nominal()[0], FREE, bounds, priors)
    assert [i.prior for i in second.items] == [(150.0, 9.0), None, (pytest.approx(priors[POINT][0] + MOVED), 0.001)]
    np.testing.assert_allclose(second.lower - first.lower, [0, 0, MOVED], atol=1e-12)
    np.testing.assert_allclose(second.upper - first.upper, [0, 0, MOVED], atol=1e-12)
    assert second.items[0].nominal == first.items[0].nominal


def reordered(scene: Scene) -> Scene:
    return replace(scene, effects=scene.effects[::-1])


def test_parameters_are_matched_by_where_they_are():
    """K1 of a scene with its effects in another order is the other tendon's."""
    one, other = nominal()
    first, second = free_in_trials([one, reordered(other)], ("K1", "K2"), 0.3, None, EXACT)[1]
    assert second.names == ("K2", "K1")
    assert [p.place.name for p in second.items] == [p.place.name for p in first.items]
    with pytest.raises(InputError, match=r"patellar_tendon\.stiffness, quadriceps\.stiffness free"):
        free_in_trials([one, reordered(other)], ("K1",), 0.3, None, EXACT)


def test_a_slack_length_as_strain_is_no_shared_number():
    with pytest.raises(InputError, match=r"quadriceps\.slack_length\.strain"):
        free_in_trials(nominal(), ("K1", "L1.strain"), {"L1.strain": (-0.5, 0.5)}, None, EXACT)


def test_a_trial_without_a_channel_of_another_is_refused():
    one, other = alike()
    renamed = replace(other.effects[other.index("contact")], name="inlay")
    scene = other.without("contact").with_effect(renamed)
    data = [replace(measured_alike()[0], contact_force=np.ones(41)), measured_alike()[1]]
    with pytest.raises(InputError, match="high has no 'contact', which another trial has"):
        fitted([one, scene], data, use=("position", "contact"), noise=None)


def test_an_estimate_from_a_file_gets_all_its_scenes(tmp_path):
    path = together().save(tmp_path / "fit.json")
    scenes = [replace(s, measured=m) for s, m in zip(alike(), measured_alike(), strict=True)]
    again = Estimate.load(path, scenes)
    assert likelihood_of(again, None).objective.present.sum() == 41 * 3 + 41 * 3 + 37
    with pytest.raises(InputError, match="fitted to 2 trials, and 1 of their scenes given"):
        likelihood_of(Estimate.load(path, scenes[0]), None)


def test_frames_of_two_trials_are_not_correlated():
    """A score that falls in the second trial as it rose in the first: each trial's products alone, and their sum."""
    ramp = np.linspace(-1.0, 1.0, 60)
    z = np.concatenate([ramp, [0.0], -ramp])[:, None]
    frames, a = rows_of_trials([60, 60]), np.ones((121, 1, 1))
    whole = long_run_score(a, z, 0.9, frames)
    assert whole == pytest.approx(2 * long_run_score(a[:60], z[:60], 0.9))
    assert abs(float(long_run_score(a, z, 0.9)[0, 0] / whole[0, 0]) - 1) > 0.1


def test_noise_of_two_trials_is_not_correlated():
    target = replace(made(9, ("position",), 1), frames=rows_of_trials([4, 4]))
    drawn = Noise(np.full(3, 0.2), np.full(3, 0.95), 1.0).drawn(4000, target, np.random.default_rng(3))[..., 0]
    correlation = np.corrcoef(drawn.T)
    assert correlation[2, 3] == pytest.approx(0.95, abs=0.02)
    assert abs(correlation[3, 5]) < 0.06
    np.testing.assert_allclose(drawn.std(axis=0)[[0, 5]], 0.2, rtol=0.05)


def test_trials_of_one_name_get_numbers():
    scenes = [replace(small_scene(), name=name) for name in ("a", "a (2)", "a")]
    assert trial_names(scenes) == ["a", "a (2)", "a (3)"]


@pytest.mark.parametrize(
    ("scenes", "data", "more", "said"),
    [
        ((), None, {}, "no trial"),
        ((0, 1), (0,), {}, "1 given, and 2 scenes"),
        ((0, 1), None, {}, "nothing to compare with"),
        ((0, 1), (0, 1), {"use": "quadriceps"}, "nothing of quadriceps was measured in low"),
        ((0, 1), (0, 1), {"use": "orientation"}, "no 'orientation' was measured"),
        ((0, 1), (0, 1), {"noise": {"position": 1e-4}}, "no noise of 'quadriceps'"),
    ],
)
def test_trials_that_share_nothing_are_refused(scenes, data, more, said):
    given = None if data is None else [measured_alike()[i] for i in data]
    with pytest.raises(InputError, match=said):
        fitted([alike()[i] for i in scenes], given, **more)


def test_a_shared_number_that_scenes_have_at_other_values_is_refused():
    """The rig's case 3 has a longer quadriceps tendon than case 2: one value of both would fit neither."""
    one, other = alike()
    longer = other.set("L2", 0.075)
    with pytest.raises(InputError, match=r"L2 is 0\.0714 in trial 1 and 0\.075 in trial 2; .*varies=\{'L2': \.\.\.\}"):
        fitted([one, longer], measured_alike())
    varied = free_in_trials([one, longer], FREE, BOUNDS, None, EXACT, {"L2": 0.002})[1]
    assert varied[1].nominal[1] == varied[0].nominal[1]


def test_measurements_in_the_place_of_a_scene_are_refused():
    with pytest.raises(InputError, match="scene: found Measured"):
        fitted(measured_alike()[0], None)


def test_a_trial_with_other_tendons_is_refused():
    one, other = alike()
    with pytest.raises(InputError, match=r"only one of trials 1 and 2 has .*damping"):
        fitted([one, other.set("quadriceps.damping", 0.0)], measured_alike(), nuisance="damping=0.5")
