"""Posterior sampling against the intervals of a small knee's fit; densities that are known: test_randomised."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from lifted_fits import COMPUTED, SPRINGS
from small_scene import small_scene

import fitting
import pftwin
from fitting.evaluation import Evaluator
from fitting.posterior.sampling import chain_runner
from pftwin.base.errors import InputError, MissingExtraError
from pftwin.files.result_files import load_dataset
from pftwin.model.measured import Measured

TRUTH = np.array([156.0, 0.1432, 629.0, 0.0714]) * np.array([1.05, 0.98, 0.96, 1.01])
NOISE = 1e-4  # [m]
FORCE_NOISE = 0.02  # [N]
FORCES = {"quadriceps": "tension", "patellar_tendon": "tension", "contact": "force"}


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def truth(scene):
    return pftwin.simulate(
        fitting.free_parameters(scene, SPRINGS).apply(scene, TRUTH), dt=1 / 600, integrator=pftwin.LinearImplicit()
    )


def fitted(scene, truth, noise, use=("position", "quadriceps")):
    """With one spring's force measured as well: positions alone leave the common scale of both stiffnesses open."""
    random = np.random.default_rng(9)
    exact = {name: truth.effects[name][what] for name, what in FORCES.items()}
    force = {name: values + FORCE_NOISE * random.normal(size=values.shape) for name, values in exact.items()}
    measured = Measured(
        truth.times,
        truth.center + noise,
        femoral_spring_force=force["quadriceps"],
        tibial_spring_force=force["patellar_tendon"],
        contact_force=force["contact"],
        synthetic=True,
    )
    return fitting.fit_tendons(scene, measured, use=use, starts=4)


@pytest.fixture(scope="module")
def noise(truth):
    return np.random.default_rng(0).normal(0.0, NOISE, truth.center.shape)


@pytest.fixture(scope="module")
def estimate(scene, truth, noise):
    """With all forces measured: by the program of `lifted_fits`."""
    return fitted(scene, truth, noise, COMPUTED)


@pytest.fixture(scope="module")
def by_one_force(scene, truth, noise):
    return fitted(scene, truth, noise)


@pytest.fixture(scope="module")
def design(scene):
    """By how much positions and the force, in units of their noise, react to the springs (frames, 4, 4): central
    differences of plain simulations, which share nothing with a fit's derivatives."""
    p = fitting.free_parameters(scene, SPRINGS)

    def simulated(theta):
        result = pftwin.simulate(p.apply(scene, theta), dt=1 / 600, integrator=pftwin.LinearImplicit())
        return np.column_stack([result.center, result.effects["quadriceps"]["tension"]])

    steps = np.diag(1e-4 * TRUTH)
    columns = [(simulated(TRUTH + step) - simulated(TRUTH - step)) / (2 * step.sum()) for step in steps]
    return np.stack(columns, axis=-1) / np.array([NOISE, NOISE, NOISE, FORCE_NOISE])[:, None]


@pytest.fixture(scope="module")
def posterior(estimate):
    simulated = []
    found = fitting.sample_posterior(estimate, draws=250, progress=lambda *now: simulated.append(now))
    assert simulated[-1] == (1100, 1100)
    return found


@pytest.mark.slow
def test_one_program_serves_fits_to_other_channels(scene, by_one_force):
    """It computes both channels; the one that is compared is picked, whatever their order."""
    p = fitting.free_parameters(scene, SPRINGS)
    both = Evaluator(scene, p, ("position", "quadriceps")).with_slopes(TRUTH[None], 6)
    for channels, columns in ((("position",), slice(0, 3)), (("quadriceps",), slice(3, 4))):
        one = Evaluator(scene, p, channels, computed=("position", "quadriceps"))
        found = one.with_slopes(TRUTH[None], 6)
        np.testing.assert_array_equal(found.values, both.values[..., columns])
        np.testing.assert_array_equal(found.slopes, both.slopes[..., columns, :])
        assert found.values.shape[-1] == (3 if channels == ("position",) else 1)
    alone = fitting.fit_tendons(scene, by_one_force.measured, computed=("quadriceps", "position"), starts=4)
    assert alone.channels == ("position",)
    assert 0.9 * NOISE < alone.rmse["position"] < by_one_force.rmse["position"]  # with the force it gives way a little


@pytest.mark.slow
def test_a_knees_posterior_is_as_wide_as_its_noise_and_derivatives_say(by_one_force, design):
    """The noise is known and small, so the posterior is all but normal: its covariance follows from the design."""
    posterior = fitting.sample_posterior(by_one_force, draws=250)
    exact = np.linalg.inv(np.einsum("tcp,tcq->pq", design, design))
    sd = np.sqrt(np.diagonal(exact))
    draws = posterior.draws.reshape(-1, 4)
    np.testing.assert_allclose(draws.std(axis=0) / sd, 1.0, atol=0.2)
    np.testing.assert_allclose(np.corrcoef(draws.T), exact / np.outer(sd, sd), atol=0.1)
    assert (np.abs(posterior.means - TRUTH) < 4 * sd).all()


def test_posterior_and_intervals_of_a_knee_agree(posterior, estimate):
    assert posterior.converged, posterior.summary()
    assert posterior.draws.shape == (4, 250, 4)
    np.testing.assert_allclose(posterior.standard_deviations, estimate.standard_deviations, rtol=0.15)
    np.testing.assert_allclose((posterior.means - estimate.values) / estimate.standard_deviations, 0.0, atol=0.2)
    assert not posterior.tempered
    assert "agrees with the estimate's 95 % intervals within" in posterior.sentence()
    assert "the measurements are synthetic" in posterior.summary()


def test_intervals_that_are_wrong_are_found_out(posterior, estimate):
    from dataclasses import replace

    wrong = replace(posterior, estimate=replace(estimate, covariance=0.5 * estimate.covariance))
    assert "differs from the estimate's 95 % intervals by up to" in wrong.sentence()
    assert "trust the posterior's" in wrong.sentence()
    few = replace(posterior, effective=np.full(4, 20.0))
    assert "more draws" in few.sentence()


@pytest.mark.slow
def test_correlated_residuals_temper_it_to_how_far_estimates_scatter(scene, truth, design):
    """Noise of known covariance Omega, A the design, both in units of the noise: estimates scatter by
    (A'A)^-1 A' Omega A (A'A)^-1, which one recording of so few frames tells to a quarter."""
    random, shape = np.random.default_rng(2), truth.center.shape
    noise = np.zeros(shape)
    for i in range(1, shape[0]):
        noise[i] = 0.8 * noise[i - 1] + 0.6 * NOISE * random.normal(size=3)
    found = fitted(scene, truth, noise)
    assert found.serial_correlation > 0.4
    posterior = fitting.sample_posterior(found, draws=250, seed=1)
    assert posterior.tempered
    lag = np.abs(np.subtract.outer(np.arange(shape[0]), np.arange(shape[0])))
    white = np.linalg.inv(np.einsum("tcp,tcq->pq", design, design))
    middle = np.einsum("tcp,ts,scq->pq", design[:, :3], 0.8**lag, design[:, :3])
    middle += np.einsum("tp,tq->pq", design[:, 3], design[:, 3])  # the force's noise is white
    exact = white @ middle @ white
    sd = np.sqrt(np.diagonal(exact))
    assert (np.sqrt(np.diagonal(white)) / sd < 0.7).all()
    np.testing.assert_allclose(posterior.standard_deviations / sd, 1.0, atol=0.25)
    assert "tempered to the estimate's covariance" in posterior.summary()


def test_what_is_saved(posterior, estimate, tmp_path):
    data = load_dataset(posterior.save(tmp_path / "posterior.nc"))
    np.testing.assert_array_equal(data["theta"], posterior.draws)
    assert list(data["parameter"].values) == list(SPRINGS)
    assert data.attrs["synthetic"] == 1
    np.testing.assert_array_equal(data["estimate"], estimate.values)
    plain = posterior.to_dict()
    assert plain["sentence"] == posterior.sentence()
    assert len(plain["quantiles"]) == len(plain["levels"])
    files = posterior.plot.save(tmp_path / "fit")
    assert sorted(f.name for f in files) == ["fit_posterior.png", "fit_posterior.svg"]
    assert "synthetic measurements" in files[1].read_text() or "synthetic measurements" in files[0].read_text()


@pytest.mark.slow
def test_an_estimate_from_a_file_needs_its_scene_and_measurements(estimate, scene, truth, tmp_path):
    path = estimate.save(tmp_path / "fit.json")
    with pytest.raises(InputError, match="holds no scene"):
        fitting.sample_posterior(fitting.Estimate.load(path))
    with pytest.raises(InputError, match="nothing to compare with"):
        fitting.sample_posterior(fitting.Estimate.load(path, scene))
    again = fitting.Estimate.load(path, scene)
    short = {"draws": 20, "warmup": 2}  # as many chains as elsewhere, by the same program
    one = fitting.sample_posterior(again, measured=estimate.measured, **short)
    np.testing.assert_array_equal(one.draws, fitting.sample_posterior(estimate, **short).draws)


@pytest.mark.parametrize("options", [{"draws": 0}, {"chains": 1}, {"warmup": 0}, {"draws": 1.5}])
def test_numbers_out_of_range(estimate, options):
    with pytest.raises(InputError, match=f"{next(iter(options))}: found"):
        fitting.sample_posterior(estimate, **options)


def test_the_papers_objective_has_no_posterior(estimate):
    from dataclasses import replace

    with pytest.raises(InputError, match="no likelihood"):
        fitting.sample_posterior(replace(estimate, objective="paper"))


def test_the_missing_extra_is_named(estimate, monkeypatch):
    chain_runner.cache_clear()
    monkeypatch.setitem(sys.modules, "blackjax.mcmc", None)
    with pytest.raises(MissingExtraError, match=r"pftwin\[posterior\]"):
        fitting.sample_posterior(estimate)
