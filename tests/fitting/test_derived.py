"""What follows from fitted parameters, where it has a closed form."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import fitting
from fitting.prediction.predicting import Fitted
from pftwin.base.errors import InputError

NAMES = ("K1", "L2")


class Normal(Fitted):
    """K1 and L2 of a scene, normal about values that are not the scene's, correlated."""

    names, units = NAMES, ("N/m", "m")
    doubts = ("a swapped marker",)

    def __init__(self, scene):
        self.values = np.array([1.1 * scene.get("K1"), 0.97 * scene.get("L2")])
        self.covariance = np.array([[4.0, 3e-3], [3e-3, 9e-6]])

    @property
    def apply(self) -> Any:
        def given(scene, theta=None):
            k1, l2 = self.values if theta is None else theta
            return scene.set("K1", k1).set("L2", l2)

        return given

    def samples(self, count: int, seed: int = 0) -> np.ndarray:
        return np.random.default_rng(seed).multivariate_normal(self.values, self.covariance, count)


def test_a_linear_function_has_the_deviation_of_its_gradient_and_the_covariance():
    """f = K1 / 2 + 700 L2: the variance is g' C g; the interval is 1.96 deviations to either side."""
    scene = small_scene()
    estimate = Normal(scene)
    found = fitting.derived(estimate, lambda s: 0.5 * s.get("K1") + 700.0 * s.get("L2"), scene, samples=40_000, seed=3)
    g = np.array([0.5, 700.0])
    sd = np.sqrt(g @ estimate.covariance @ g)
    assert found.value == pytest.approx(g @ estimate.values, rel=1e-12)
    assert found.standard_deviation == pytest.approx(sd, rel=0.02)
    np.testing.assert_allclose(found.interval() - found.value, [-1.96 * sd, 1.96 * sd], rtol=0.04)
    np.testing.assert_allclose(found.interval(0.5) - found.value, [-0.6745 * sd, 0.6745 * sd], rtol=0.06)
    assert found.doubts == ("a swapped marker",)


def test_several_numbers_are_those_of_every_draw():
    scene = small_scene()
    estimate = Normal(scene)
    found = fitting.derived(
        estimate, lambda s: jnp.stack([s.get("K1"), s.get("K1") / s.get("L2")]), scene, samples=300, seed=5
    )
    draws = estimate.samples(300, 5)
    assert found.draws.shape == (300, 2)
    np.testing.assert_allclose(found.draws, np.stack([draws[:, 0], draws[:, 0] / draws[:, 1]], axis=1), rtol=1e-12)
    assert found.interval().shape == (2, 2)


def test_what_is_not_finite_is_counted():
    """The logarithm of what is less than nothing in every draw below the middle."""
    scene = small_scene()
    estimate = Normal(scene)
    middle = estimate.values[0]
    below = int((estimate.samples(100, 4)[:, 0] <= middle).sum()) + 1  # and the estimate's own value
    with pytest.raises(InputError, match=f"function: not finite in {below} of 101 draws"):
        fitting.derived(estimate, lambda s: jnp.log(s.get("K1") - middle), scene, samples=100, seed=4)


def test_nothing_follows_from_one_draw_or_at_a_level_of_one():
    scene = small_scene()
    with pytest.raises(InputError, match="samples: found 1; expected: at least 2"):
        fitting.derived(Normal(scene), lambda s: s.get("K1"), scene, samples=1)
    found = fitting.derived(Normal(scene), lambda s: s.get("K1"), scene, samples=2)
    with pytest.raises(InputError, match="level: found 1"):
        found.interval(1.0)
