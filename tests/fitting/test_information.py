"""The Cramer-Rao bound of linear designs in closed form; profiles of linear models are parabolas."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from made_estimates import made_estimate, of_trial
from small_scene import small_scene

import fitting
from fitting import identifiability
from fitting.evaluation import Prediction
from fitting.identifiability import _crossings as crossings
from fitting.methods.problem import Problem
from fitting.programs import channel_widths
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

FRAMES, FREE = 41, ("K1", "L1", "K2")
NOISE = {"position": 3e-4, "orientation": 4e-3, "quadriceps": 0.2, "contact": 0.7}
ALL = ("position", "orientation", "contact", "quadriceps", "patellar_tendon")
SIZE = np.array([156.0, 0.1432, 629.0])


def slopes_of(channel):
    """(frames, columns, p) of a channel, reacting to each parameter's own share."""
    random = np.random.default_rng(ALL.index(channel))
    return 1e-3 * random.normal(size=(FRAMES, channel_widths((channel,))[0], 3)) / SIZE


class LinearEvaluator:
    """In the place of simulations."""

    def __init__(self, scene, parameters, channels):
        self.channels, self.first, self.fine = channels, 1, 1

    def prepare(self, widest):
        pass

    def with_slopes(self, theta, substeps):
        slopes = np.concatenate([slopes_of(c) for c in self.channels], axis=1)[None]
        return Prediction(np.zeros(slopes.shape[:3]), slopes, np.ones(1, bool))


@pytest.fixture
def plan(monkeypatch):
    monkeypatch.setattr(identifiability, "Evaluator", LinearEvaluator)

    def made(**more):
        options = {"free": FREE, "noise": NOISE, "use": ("position", "quadriceps"), "candidates": ("orientation",)}
        return fitting.plan_experiment(small_scene(), **{**options, **more})

    return made


def information(channel, noise=None):
    """Sum of a'a / noise^2; an angle is twice what the quaternion's vector part turns."""
    a = slopes_of(channel).reshape(-1, 3) * (2 if channel == "orientation" else 1)
    return a.T @ a / (NOISE[channel] if noise is None else noise) ** 2


def test_the_bound_is_the_inverse_of_all_channels_information(plan):
    base = information("position") + information("quadriceps")
    found = plan()
    np.testing.assert_allclose(found.covariance, np.linalg.inv(base), rtol=1e-8)
    np.testing.assert_allclose(found.relative, np.sqrt(np.diagonal(np.linalg.inv(base))) / SIZE, rtol=1e-8)
    values = np.linalg.eigvalsh(base * np.outer(SIZE, SIZE))
    assert found.condition == pytest.approx(values[-1] / values[0])
    assert found.unfelt == ()


def test_a_plan_tells_which_trial_it_is_at(plan):
    reports = []
    plan(further=[small_scene()], progress=lambda *counts: reports.append(counts))
    assert reports == [(0, 2, "linearising small knee"), (1, 2, "linearising small knee (2)")]


def test_twice_the_noise_is_twice_the_deviation(plan):
    """Of all channels at once; each channel has its own, those not given the defaults 0.2 mm, 5 mrad, 0.15 N."""
    twice = plan(noise={c: 2 * s for c, s in NOISE.items()})
    np.testing.assert_allclose(twice.relative, 2 * plan().relative, rtol=1e-8)
    default = plan(noise=None, candidates=())
    expected = information("position", 2e-4) + information("quadriceps", 0.15)
    np.testing.assert_allclose(default.covariance, np.linalg.inv(expected), rtol=1e-8)


def test_a_prior_is_a_measurement_of_the_parameter(plan):
    sd = 0.5 * np.sqrt(plan().covariance[1, 1])
    base = information("position") + information("quadriceps") + np.diag([0, sd**-2, 0])
    found = plan(priors={"L1": (0.14, sd)})
    np.testing.assert_allclose(found.covariance, np.linalg.inv(base), rtol=1e-8)


def test_what_more_would_help_adds_its_information_and_the_best_comes_first(plan):
    found = plan(candidates=("orientation", "contact"))
    base = information("position") + information("quadriceps")
    for channel, deviations in found.additions.items():
        expected = np.sqrt(np.diagonal(np.linalg.inv(base + information(channel)))) / SIZE
        np.testing.assert_allclose(deviations, expected, rtol=1e-8)
        assert (deviations <= found.relative).all()
    worst = [d.max() for d in found.additions.values()]
    assert len(worst) == 2
    assert worst == sorted(worst)


@pytest.mark.parametrize("center", [0.0, 0.37, -0.8])
def test_a_parabolas_crossings_are_its_196_standard_deviations(center):
    held = np.linspace(-3, 3, 13)
    deviance = (held - center) ** 2
    low, high = crossings(held, deviance - deviance.min())
    assert (low, high) == pytest.approx((center - 1.96, center + 1.96), abs=0.12)
    assert crossings(held, 0.1 * deviance) == (-np.inf, np.inf)


SIGMA = 3e-4
VALUES = np.array([160.0, 0.145, 600.0])


@pytest.fixture
def fitted(monkeypatch):
    """An estimate of a linear model, its covariance widened by a factor as where residuals are correlated."""
    scene = small_scene()
    slopes = slopes_of("position")
    slopes[..., 2] += 0.7 * slopes[..., 0] * SIZE[0] / SIZE[2]
    flat = slopes.reshape(-1, 3)
    noise = SIGMA * np.random.default_rng(7).normal(size=len(flat))
    noise -= flat @ np.linalg.lstsq(flat, noise, rcond=None)[0]  # so that the estimate is the best fit
    center = np.random.default_rng(8).normal(size=(FRAMES, 3))

    def with_slopes(theta, substeps):
        values = center + np.einsum("tmp,np->ntm", slopes, theta - VALUES)
        return Prediction(values, np.broadcast_to(slopes, (len(theta), *slopes.shape)), np.ones(len(theta), bool))

    evaluator = SimpleNamespace(with_slopes=with_slopes, fine=1, prepare=lambda widest: None)
    monkeypatch.setattr(Problem, "of", staticmethod(lambda scenes, free, o: Problem(scenes[0], free[0], o, evaluator)))
    measured = Measured(scene.motion.times, center + noise.reshape(FRAMES, 3))

    def made(factor=1.0):
        covariance = factor * SIGMA**2 * np.linalg.inv(flat.T @ flat)
        return made_estimate(
            {name: (value, 1.0) for name, value in zip(FREE, VALUES, strict=True)},
            covariance=covariance,
            lower=0.01 * VALUES,
            upper=3 * VALUES,
            objective="likelihood",
            noise={"position": SIGMA},
            **of_trial(scene, measured),
        )

    return made


@pytest.mark.parametrize("factor", [1.0, 2.5])
@pytest.mark.parametrize("i", [0, 1, 2])
def test_the_profile_of_a_linear_model_is_its_parabola(fitted, i, factor):
    """((x - estimate) / deviation)^2, the others along the covariance's column; it crosses at 1.96 deviations."""
    estimate = fitted(factor)
    sd = estimate.standard_deviations[i]
    profile = fitting.profile_likelihood(estimate, FREE[i], points=13, reach=2.5)
    np.testing.assert_allclose(profile.values, VALUES[i] + sd * np.linspace(-2.5, 2.5, 13))
    np.testing.assert_allclose(profile.deviance, np.linspace(-2.5, 2.5, 13) ** 2, atol=1e-6)
    column = estimate.covariance[i] / estimate.covariance[i, i]
    expected = VALUES + (profile.values - VALUES[i])[:, None] * column
    np.testing.assert_allclose((profile.theta - expected) / estimate.standard_deviations, 0, atol=1e-4)
    np.testing.assert_allclose(profile.interval, VALUES[i] + 1.959964 * sd * np.array([-1, 1]), rtol=1e-6)


def test_a_profile_that_does_not_rise_far_is_open(fitted):
    profile = fitting.profile_likelihood(fitted(), "L1", reach=1.0)
    assert profile.interval == (-np.inf, np.inf)


def test_a_profile_finds_the_others_best_values_from_a_wrong_covariance(fitted):
    """Where the search begins does not matter: without the correlations it ends at the same values, in two steps, since
    damping goes by the parameters' own sizes, which differ by ten thousand."""
    estimate = fitted()
    exact = fitting.profile_likelihood(estimate, "K1", points=5)
    estimate.covariance = np.diag(np.diagonal(estimate.covariance))
    found = fitting.profile_likelihood(estimate, "K1", points=5, iterations=2)
    np.testing.assert_allclose((found.theta - exact.theta) / estimate.standard_deviations, 0, atol=5e-4)
    np.testing.assert_allclose(found.deviance, exact.deviance, rtol=1e-4, atol=1e-4)


def test_noise_of_a_channel_that_the_scene_has_not_is_refused():
    """Misspelt, its default would count."""
    with pytest.raises(InputError, match=r"noise: no channel 'positions'; expected: one of: position"):
        fitting.plan_experiment(small_scene(), noise={"positions": 2e-3}, candidates=())
