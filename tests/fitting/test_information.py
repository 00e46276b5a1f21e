"""The Cramer-Rao bound of linear designs in closed form; profiles of linear models are parabolas."""

from __future__ import annotations

import numpy as np
import pytest
from small_scene import small_scene

import fitting
from fitting import identifiability
from fitting.channels import widths
from fitting.evaluation import Prediction
from fitting.identifiability import _crossings as crossings

FRAMES, FREE = 41, ("K1", "L1", "K2")
NOISE = {"position": 3e-4, "orientation": 4e-3, "quadriceps": 0.2, "contact": 0.7}
ALL = ("position", "orientation", "contact", "quadriceps", "patellar_tendon")
SIZE = np.array([156.0, 0.1432, 629.0])


def slopes_of(channel):
    """(frames, columns, p) of a channel, reacting to each parameter's own share."""
    random = np.random.default_rng(ALL.index(channel))
    return 1e-3 * random.normal(size=(FRAMES, widths((channel,))[0], 3)) / SIZE


class LinearEvaluator:
    """In the place of simulations."""

    def __init__(self, scene, parameters, channels):
        self.channels, self.fine, self.widths = channels, 1, widths(channels)

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
