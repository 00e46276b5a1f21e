"""How sure an estimate is: its deviations, intervals, samples and profile; and its file."""

from __future__ import annotations

import json
from dataclasses import MISSING, fields

import numpy as np
import pytest
from lifted_fits import HELD, NOISE, TRUTH, estimate, noisy, scene
from made_estimates import made_estimate, of_trial

import fitting
import fitting.fit
from fitting.uncertainty import serial_correlation
from pftwin.base.errors import InputError


@pytest.mark.slow
def test_noise_leaves_an_error_of_the_size_that_is_reported():
    z = (estimate().values - TRUTH) / estimate().standard_deviations
    assert np.abs(z).max() < 4
    assert np.abs(z).max() > 0.01
    assert (estimate().standard_deviations / TRUTH < 0.03).all()


@pytest.mark.slow
def test_samples_have_the_covariance():
    samples = estimate().samples(20000, seed=1)
    np.testing.assert_allclose(
        np.cov(samples.T), estimate().covariance, rtol=0.1, atol=0.05 * estimate().covariance.max()
    )
    assert "positions give" in estimate().sentence()
    assert "K1" in estimate().summary()


@pytest.mark.slow
def test_planning_tells_what_a_fit_reports():
    plan = fitting.plan_experiment(estimate().scene, noise={"position": NOISE}, candidates=())
    np.testing.assert_allclose(plan.covariance, estimate().covariance, rtol=0.05)
    assert plan.sentence().startswith("at best, positions fix")
    with pytest.raises(InputError, match="no channel"):
        fitting.plan_experiment(scene(), use=("magic",))


@pytest.mark.slow
def test_a_profile_is_about_a_parabola():
    profile = fitting.profile_likelihood(estimate(), "L2", points=9)
    low, high = profile.interval
    np.testing.assert_allclose([low, high], estimate().intervals[3], atol=0.5 * estimate().standard_deviations[3])
    with pytest.raises(InputError, match="no parameter"):
        fitting.profile_likelihood(estimate(), "K7")


def test_serial_correlation_is_detected():
    random = np.random.default_rng(0)
    white = random.normal(size=(2000, 3))
    present = np.ones(white.shape, bool)
    assert abs(serial_correlation(white, present)) < 0.05
    assert serial_correlation(np.cumsum(white, axis=0), present) > 0.9


def test_an_estimate_is_saved_and_loaded(tmp_path):
    found = made_estimate({"K1": (157.0, 2.0), "L2": (0.0713, 2e-4)}, **of_trial(scene()))
    path = found.save(tmp_path / "fit.json")
    again = fitting.Estimate.load(path, scene())
    assert again.to_dict() == found.to_dict()
    assert json.loads(path.read_text())["sentence"] == found.sentence()
    assert float(again.scene.get("K1")) == 157.0
    assert float(again.scene.get("L2")) == 0.0713
    with pytest.raises(InputError, match="holds no scene"):
        _ = fitting.Estimate.load(path).scene


def test_a_file_may_lack_what_has_a_default_and_nothing_else(tmp_path):
    path = made_estimate({"K1": (157.0, 2.0), "L2": (0.0713, 2e-4)}, **of_trial(scene())).save(tmp_path / "fit.json")
    content = json.loads(path.read_text())
    own = {f.name for f in fields(fitting.Estimate) if f.default is MISSING and f.default_factory is MISSING}
    path.write_text(json.dumps({k: v for k, v in content.items() if k in own or k == "format"}))
    found = fitting.Estimate.load(path)
    assert (found.doubts, found.time_shifts, found.substeps, found.draws) == ([], {}, 0, None)
    assert found.values.tolist() == content["values"]
    path.write_text(json.dumps({k: v for k, v in content.items() if k != "covariance"}))
    with pytest.raises(InputError, match="no estimate: it lacks 'covariance'"):
        fitting.Estimate.load(path)


def test_no_file_and_no_estimate(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        fitting.Estimate.load(tmp_path / "none.json")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="no estimate"):
        fitting.Estimate.load(tmp_path / "other.json")


@pytest.mark.slow
def test_intervals_cover_the_truth():
    """95 % intervals of 200 repeats cover the truth() in 90 to 99 %."""
    covered = []
    for seed in range(200):
        found = fitting.fit_tendons(scene(HELD), noisy(1000 + seed, HELD), starts=2)
        covered.append((found.intervals[:, 0] <= TRUTH) & (found.intervals[:, 1] >= TRUTH))
    share = np.mean(covered, axis=0)
    assert (share >= 0.90).all(), share
    assert (share <= 0.99).all(), share
