"""`fit_tendons(method="simulations")`: against least squares, its estimates' files and draws, what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lifted_fits import HELD, NOISE, TRUTH, estimate, noisy, scene
from made_estimates import made_estimate

import fitting
from fitting.coverage import QUICK, SIMULATIONS, SIMULATIONS_WITH_NUISANCE
from fitting.estimate import Estimate
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured


def drawn() -> Estimate:
    """An estimate with skewed draws, so that quantiles are not what a normal distribution gives."""
    random = np.random.default_rng(3)
    draws = np.stack([150 + 8 * random.gamma(2.0, size=3000), 0.07 + 1e-4 * random.normal(size=3000)], axis=1)
    numbers = {n: (float(c.mean()), float(c.std())) for n, c in zip(("K1", "L2"), draws.T, strict=True)}
    return made_estimate(numbers, draws=draws, method="simulations")


def test_intervals_are_the_draws_quantiles():
    found = drawn()
    inside = (found.draws > found.intervals[:, 0]) & (found.draws < found.intervals[:, 1])
    np.testing.assert_allclose(inside.mean(axis=0), 0.95, atol=1e-3)
    low, high = found.intervals[0]
    assert high - found.values[0] > 1.5 * (found.values[0] - low)  # skewed as a gamma distribution of shape 2 is


def test_what_is_said_of_intervals_is_said_of_simulations():
    found = drawn()
    assert SIMULATIONS.intervals in found.sentence()
    assert QUICK.intervals not in found.sentence()
    found.auxiliary, found.dropped, found.starts = ("L2",), 7, 900
    assert SIMULATIONS_WITH_NUISANCE.intervals in found.sentence()
    assert found.coverage == SIMULATIONS_WITH_NUISANCE
    assert "7 of 900 simulations found no equilibrium" in found.remarks()[-1]


def test_an_interval_that_reaches_a_bound_is_reported():
    found = drawn()
    assert found.at_bounds == ()
    found.lower = np.array([found.intervals[0, 0], found.lower[1]])
    assert found.at_bounds == ("K1",)


def test_samples_are_draws_each_once_while_there_are_enough():
    found = drawn()
    some = found.samples(3000, seed=5)
    np.testing.assert_array_equal(np.sort(some, axis=0), np.sort(found.draws, axis=0))
    assert not np.array_equal(some, found.draws)
    assert found.samples(5000).shape == (5000, 2)


def test_draws_are_in_the_file(tmp_path):
    found = drawn()
    again = Estimate.load(found.save(tmp_path / "fit.json"))
    np.testing.assert_allclose(again.draws, found.draws, rtol=1e-6)
    np.testing.assert_allclose(again.intervals, found.intervals, rtol=1e-6)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"objective": "paper"}, "no objective 'paper'"),
        ({"noise": {"position": NOISE}, "loss": "huber"}, "no loss 'huber'"),
        ({"checkpoint": "fit.checkpoint"}, "keep no checkpoint"),
        ({"starts": 3}, "no option 'starts'"),
        ({"simulations": 100}, "at least 1000"),
    ],
)
def test_what_simulations_do_not_know_is_refused(more, said):
    times = scene(HELD).motion.times
    measured = Measured(times, np.zeros((times.size, 3)))
    with pytest.raises(InputError, match=said):
        fitting.fit_tendons(scene(HELD), measured, method="simulations", **more)


@pytest.mark.slow
def test_the_posterior_is_that_of_least_squares_where_the_model_is_right():
    """White noise of known size on the twin's own motion: the covariance of least squares is the posterior's."""
    reports = []
    found = fitting.fit_tendons(
        scene(HELD), noisy(0, HELD), noise={"position": NOISE}, method="simulations", progress=reports.append
    )
    other = estimate()
    assert (np.abs(found.values - other.values) < 0.4 * other.standard_deviations).all()
    np.testing.assert_allclose(found.standard_deviations, other.standard_deviations, rtol=0.3)
    assert (np.abs(found.values - TRUTH) < 4 * found.standard_deviations).all()
    assert found.method == "simulations"
    assert found.rmse["position"] < 1.3 * np.sqrt(3) * NOISE
    assert not found.invalid
    assert [p.iteration for p in reports] == list(range(1, len(reports) + 1))
    assert reports[-1].spread < 0.1


@pytest.mark.slow
def test_measurements_of_another_knee_are_not_believed():
    """Positions 40 mm off along each axis, and millimetres for metres."""
    measured = noisy(0, HELD)
    with pytest.raises(InputError, match="millimetres"):
        fitting.fit_tendons(
            scene(HELD), replace(measured, center=1e3 * measured.center), method="simulations", simulations=1000
        )
    with pytest.raises(InputError, match=r"residual of position: 6\d\.\d mm rms"):
        fitting.fit_tendons(
            scene(HELD),
            replace(measured, center=measured.center + 0.04),
            method="simulations",
            simulations=1000,
            rounds=1,
        )


@pytest.mark.slow
def test_what_makes_no_difference_is_refused_before_anything_is_drawn():
    """A stiffness that may change by 2e-9 N/m moves nothing that could be seen."""
    k1 = float(scene(HELD).get("K1"))
    with pytest.raises(InputError, match=r"reacts to K1(\W|$)"):
        fitting.fit_tendons(
            scene(HELD), noisy(0, HELD), method="simulations", free=("K1", "L1"), bounds={"K1": (k1 - 1e-9, k1 + 1e-9)}
        )
