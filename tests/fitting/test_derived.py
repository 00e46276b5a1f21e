"""What follows from fitted parameters, where it has a closed form."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import fitting
import pftwin
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


def test_what_is_not_finite_is_counted_and_left_out():
    """The root of what is less than nothing in the two least draws of a hundred; in twenty it is refused."""
    scene = small_scene()
    estimate = Normal(scene)
    drawn = np.sort(estimate.samples(100, 4)[:, 0])
    least, many = drawn[1:3].mean(), drawn[19:21].mean()
    found = fitting.derived(estimate, lambda s: jnp.sqrt(s.get("K1") - least), scene, samples=100, seed=4)
    assert found.failed == 2
    np.testing.assert_allclose(np.sort(found.draws), np.sqrt(drawn[2:] - least), rtol=1e-9)
    with pytest.raises(InputError, match="function: not finite in 20 of 100 draws"):
        fitting.derived(estimate, lambda s: jnp.sqrt(s.get("K1") - many), scene, samples=100, seed=4)
    with pytest.raises(InputError, match="function: not finite at the estimate's values"):
        fitting.derived(estimate, lambda s: jnp.log(s.get("K1") - 1e6), scene, samples=100)


@pytest.mark.slow
def test_a_motion_follows_from_parameters():
    """The largest contact force of every draw is that of `pftwin.simulate` with its values."""
    scene = small_scene()
    estimate = Normal(scene)

    def most(s):
        return pftwin.trajectory(s, dt=1e-3).contact_force.norm().max()

    found = fitting.derived(estimate, most, scene, samples=3, seed=1)
    for value, theta in zip(found.draws, estimate.samples(3, 1), strict=True):
        result = pftwin.simulate(estimate.apply(scene, theta), dt=1e-3)
        assert value == pytest.approx(float(np.linalg.norm(result.contact_force, axis=-1).max()), rel=1e-9)


def test_nothing_follows_from_one_draw_or_at_a_level_of_one():
    scene = small_scene()
    with pytest.raises(InputError, match="samples: found 1; expected: at least 2"):
        fitting.derived(Normal(scene), lambda s: s.get("K1"), scene, samples=1)
    found = fitting.derived(Normal(scene), lambda s: s.get("K1"), scene, samples=2)
    with pytest.raises(InputError, match="level: found 1"):
        found.interval(1.0)
