"""Posteriors that are trained once for a set-up: against least squares on other knees, and what they are not for."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from lifted_fits import HELD, NOISE, SPRINGS, TRUTH, noisy, scene
from lifting_scene import lifting_scene

import fitting
import pftwin
from fitting.estimate import Estimate
from fitting.inference.network import PosteriorNetwork, leaves_of, network_of
from fitting.methods.problem import standard_promotion
from fitting.trained import TrainedPosterior
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

FACTORS = np.array([[0.9, 1.02, 1.1, 0.985], [1.12, 0.98, 0.95, 1.01], [0.95, 0.99, 1.05, 1.015]])
KNEES = np.array([156.0, 0.1432, 629.0, 0.0714]) * FACTORS


@cache
def trained() -> TrainedPosterior:
    return fitting.train_posterior(
        scene(HELD), noisy(0, HELD), free=SPRINGS, noise={"position": NOISE}, simulations=12_000, seed=4
    )


def moved(knee: Scene, springs: np.ndarray, seed: int, noise: float = NOISE) -> Measured:
    """A recording of a knee with other springs."""
    own = fitting.free_parameters(knee, SPRINGS).apply(knee, springs)
    result = pftwin.simulate(own, dt=1 / 2400, integrator=pftwin.LinearImplicit())
    return Measured(result.times, result.center + np.random.default_rng(seed).normal(0.0, noise, result.center.shape))


@cache
def answered(number: int) -> Estimate:
    return trained().estimate(scene(HELD), moved(scene(HELD), KNEES[number], number))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_one_training_answers_for_several_knees_as_least_squares_does(number):
    found = answered(number)
    other = fitting.fit_tendons(scene(HELD), found.measured, noise={"position": NOISE}, starts=8)
    assert not found.invalid, found.sentence()
    wider = found.standard_deviations / other.standard_deviations
    assert (wider > 0.8).all(), wider
    assert (wider < 2.5).all(), wider  # learned from 12,000 simulations of all knees, not from those like this one
    assert (np.abs(found.values - other.values) < 1.5 * found.standard_deviations).all()
    assert (np.abs(found.values - KNEES[number]) < 4 * found.standard_deviations).all()
    assert found.method == "simulations"
    assert "a posterior trained by" in found.reason


@pytest.mark.slow
def test_it_is_the_same_from_a_file(tmp_path):
    again = TrainedPosterior.load(trained().save(tmp_path / "knee.npz"), scene(HELD))
    measured = answered(1).measured
    assert measured is not None
    found = again.estimate(scene(HELD), measured)
    np.testing.assert_allclose(found.draws, answered(1).draws, rtol=1e-6)
    assert again.facts() == trained().facts()


@pytest.mark.slow
def test_short_gaps_are_bridged_and_long_ones_refused():
    measured = answered(0).measured
    assert measured is not None
    center = measured.center.copy()
    center[[7, 20, 21]] = np.nan
    found = trained().estimate(scene(HELD), replace(measured, center=center))
    assert (np.abs(found.values - answered(0).values) < 0.5 * found.standard_deviations).all()
    center[5:12] = np.nan
    with pytest.raises(InputError, match="22% of a channel's frames are missing"):
        trained().estimate(scene(HELD), replace(measured, center=center))


@pytest.mark.slow
def test_a_motion_a_little_different_is_answered_and_another_refused():
    """The tibia jerks by 0.3 mm more; or by half."""
    near = lifting_scene(height=HELD + 0.0003)
    found = trained().estimate(near, moved(near, KNEES[0], 5))
    assert (np.abs(found.values - KNEES[0]) < 4 * found.standard_deviations).all()
    assert not found.invalid, found.sentence()
    other = lifting_scene(height=HELD / 2)
    with pytest.raises(InputError, match=r"in this motion and set-up the error of the trained posterior is \d+"):
        trained().estimate(other, moved(other, KNEES[0], 5))


@pytest.mark.slow
def test_another_set_up_is_refused():
    """A patella three times as heavy, whose inertia moves it otherwise."""
    heavy = eqx.tree_at(lambda s: s.patella.mass, scene(HELD), 3 * scene(HELD).patella.mass)
    with pytest.raises(InputError, match="in this motion and set-up"):
        trained().estimate(heavy, moved(heavy, KNEES[0], 5))


@pytest.mark.slow
def test_noise_beyond_what_was_trained_for_is_named_and_refused():
    loud = moved(scene(HELD), KNEES[0], 5, noise=5 * NOISE)
    assert "times the training noise" in trained().estimate(scene(HELD), loud).sentence()
    with pytest.raises(InputError, match=r"the part of them that no simulation explains is \d+ times"):
        trained().estimate(scene(HELD), moved(scene(HELD), KNEES[0], 5, noise=20 * NOISE))


@pytest.mark.slow
def test_a_recording_unlike_all_that_was_simulated_is_named_and_refused():
    """A slack length at half of its nominal value, where bounds end at 0.7."""
    measured = moved(scene(HELD), np.array([156.0, 0.1432, 629.0, 0.0714]) * [1.0, 0.5, 1.0, 1.0], 5)
    found = trained().estimate(scene(HELD), measured)
    assert found.invalid
    assert "the measurements lie outside of what was simulated" in found.sentence()
    assert "L1" in found.at_bounds
    with pytest.raises(InputError, match="the measurements lie outside of what was simulated"):
        trained().estimate(scene(HELD), measured, limits={"simulated": (2.0, 6.0)})


@pytest.mark.slow
def test_other_frames_are_refused():
    short = lifting_scene(31, height=HELD)
    with pytest.raises(InputError, match=r"31 frames.*\n*.*41"):
        trained().estimate(short, moved(short, TRUTH, 5))


def test_a_network_is_the_same_from_its_leaves():
    net = PosteriorNetwork(7, 3, seed=5)
    again = network_of(7, 3, leaves_of(net))
    at = jnp.asarray(np.random.default_rng(0).normal(size=7), jnp.float32)
    with standard_promotion():
        for one, other in zip(net(at), again(at), strict=True):
            np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match="weights of shapes"):
        network_of(6, 3, leaves_of(net))


@pytest.mark.parametrize("content", [None, b"no archive", b"PK\x03\x04broken"])
def test_a_file_that_holds_no_posterior_is_refused(content: bytes | None, tmp_path: Path):
    path = tmp_path / "knee.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="no such file" if content is None else "no trained posterior"):
        TrainedPosterior.load(path, scene(HELD))


def test_a_file_of_other_numbers_is_refused(tmp_path: Path):
    np.savez(tmp_path / "other.npz", a=np.arange(3))
    with pytest.raises(InputError, match="no trained posterior"):
        TrainedPosterior.load(tmp_path / "other.npz", scene(HELD))
