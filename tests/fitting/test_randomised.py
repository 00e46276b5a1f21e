"""Sampling densities that are known: normal, tempered, cut off, bent, and not those of their proposals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bent_problems import bent, cubic, linear, problem
from scipy import stats

from fitting.posterior import sampling
from fitting.posterior.density import Density, tempering
from fitting.posterior.sampling import proposals, sample_posterior, sampled
from fitting.uncertainty import uncertainty
from pftwin.base.errors import InputError


@pytest.fixture(scope="module")
def line():
    """A linear problem's function, and its exact posterior: mean and covariance."""
    random = np.random.default_rng(0)
    design = (random.normal(size=(60, 3, 2)) + np.array([1.0, 0.8])) / 0.3
    measured = design @ np.array([1.0, 2.0]) + random.normal(size=(60, 3))
    flat = design.reshape(-1, 2)
    covariance = np.linalg.inv(flat.T @ flat)
    return linear(design, measured), covariance @ flat.T @ measured.ravel(), covariance


def drawn(density, draws=2000, seed=0):
    made = proposals(density, 4 * (draws + 10), np.random.default_rng(seed))
    found = sampled(*made[:3], chains=4, warmup=10, seed=seed)
    assert found.theta.shape == (4, draws, 2)
    assert found.acceptance.shape == (4,)
    return found, made


def assert_moments(density, mean, covariance):
    flat = drawn(density)[0].theta.reshape(-1, 2)
    sd = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose((flat.mean(axis=0) - mean) / sd, 0.0, atol=0.05)
    np.testing.assert_allclose(np.cov(flat.T) / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=0.06)


def test_a_linear_problem_has_its_exact_posterior_wherever_the_frame_is_from(line):
    function, mean, covariance = line
    for centre in (mean, mean + 3 * np.sqrt(np.diagonal(covariance))):
        density = Density.about(problem(function), centre)
        assert_moments(density, mean, covariance)
    found, made = drawn(density, 50)
    assert (found.acceptance == 1).all()  # proposals are the posterior itself
    assert made.outside == made.unsolved == 0


@pytest.mark.parametrize("unit", [1e-8, 1e8])
def test_units_of_parameters_make_no_difference(unit):
    """The same problem with its second parameter in another unit, so far from 1 as no physical one is."""
    random = np.random.default_rng(0)
    design = random.normal(size=(60, 3, 2)) + np.array([1.0, 0.8])
    wide = (-50.0, -50.0 / unit), (50.0, 50.0 / unit)
    density = Density.about(problem(linear(design * [1, unit], np.zeros((60, 3))), *wide), np.zeros(2))
    points = random.normal(size=(5, 2)) * 0.1
    one = Density.about(problem(linear(design, np.zeros((60, 3)))), np.zeros(2))(points)
    np.testing.assert_allclose(density(points / [1, unit]).log_density, one.log_density, rtol=1e-9)


def test_a_prior_belongs_to_it(line):
    function, mean, covariance = line
    sd = np.sqrt(covariance[0, 0])
    prior = (mean[0] + 2 * sd, sd)
    exact = np.linalg.inv(np.linalg.inv(covariance) + np.diag([1 / sd**2, 0.0]))
    shifted = exact @ (np.linalg.solve(covariance, mean) + np.array([prior[0] / sd**2, 0.0]))
    assert_moments(Density.about(problem(function, prior=prior), mean), shifted, exact)


def test_residuals_along_the_frame_have_their_slopes_and_those_of_a_prior(line):
    """Proposals are built of these; draws are right even with wrong ones, only fewer are accepted."""
    function, mean, _covariance = line
    density = Density.about(problem(function, prior=(mean[0] + 0.02, 0.03)), mean)
    h = 1e-6 * np.eye(2)
    up, down = density(mean + h).along, density(mean - h).along
    np.testing.assert_allclose(density(mean[None]).slope[0], (up - down).T / 2e-6, rtol=1e-6, atol=1e-6)


def test_a_combination_far_wider_than_the_widest_of_all_but_one_is_open():
    with pytest.raises(InputError, match="leave a combination of the parameters open"):
        tempering(np.eye(3), np.diag([1e-6, 1.0, 1e8]))


def test_tempering_gives_the_estimates_covariance(line):
    function, mean, covariance = line
    widen = np.array([[4.0, 1.0], [1.0, 0.7]])
    wanted = widen @ covariance @ widen.T
    assert_moments(Density.about(problem(function), mean, wanted), mean, wanted)
    a = tempering(np.linalg.inv(covariance), wanted)
    np.testing.assert_allclose(a.T @ np.linalg.inv(covariance) @ a, np.linalg.inv(wanted), rtol=1e-9)
    units = np.diag([1e3, 1e-4])
    other = tempering(np.linalg.inv(units @ covariance @ units), units @ wanted @ units)
    np.testing.assert_allclose(other, units @ a @ np.linalg.inv(units), rtol=1e-6)
    np.testing.assert_allclose(tempering(np.linalg.inv(covariance), covariance), np.eye(2), atol=1e-9)


@pytest.mark.slow
def test_with_correlated_noise_it_is_as_wide_as_estimates_scatter():
    """Noise of known covariance Omega, and slow designs: estimates scatter by (A'A)^-1 A' Omega A (A'A)^-1, here twice
    to three times as far as if it were white. From one recording, by residuals, covariance, tempering and draws."""
    frames, ar = 2000, 0.8
    t = np.arange(frames)[:, None, None] / frames
    design = 0.2 * np.cos(2 * np.pi * (1 + np.arange(6).reshape(1, 3, 2)) * t) + [[[0.1, 0.05]] * 3]
    omega = ar ** np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    noise = np.linalg.cholesky(omega) @ np.random.default_rng(6).normal(size=(frames, 3))
    inverse = np.linalg.inv(np.einsum("tmp,tmq->pq", design, design))
    exact = inverse @ np.einsum("tmp,tmq->pq", design, np.tensordot(omega, design, 1)) @ inverse
    truth = np.array([1.0, 2.0])
    measured = np.einsum("tmp,p->tm", design, truth) + noise
    found = inverse @ np.einsum("tmp,tm->p", design, measured)
    ours = problem(linear(design, measured))
    left = np.einsum("tmp,p->tm", design, found) - measured
    sure = uncertainty(ours.objective, ours.parameters, left, design, found)
    draws = drawn(Density.about(ours, found, sure.covariance), 1000)[0].theta.reshape(-1, 2)
    deviations = np.sqrt(np.diagonal(exact))
    assert (deviations > 2 * np.sqrt(np.diagonal(inverse))).all()
    np.testing.assert_allclose(draws.std(axis=0) / deviations, 1.0, atol=0.2)
    np.testing.assert_allclose((draws.mean(axis=0) - found) / deviations, 0.0, atol=0.1)


def test_bounds_cut_a_density(line):
    function, mean, covariance = line
    sd = np.sqrt(np.diagonal(covariance))
    lower, upper = mean - np.array([0.5, 50]) * sd, mean + np.array([1.0, 50]) * sd
    found, made = drawn(Density.about(problem(function, lower, upper), mean))
    a = (found.theta[:, ::3, 0].ravel() - mean[0]) / sd[0]
    assert stats.kstest(a, stats.truncnorm(-0.5, 1.0).cdf).pvalue > 1e-3
    assert made.outside > 0.3 * found.theta[..., 0].size


@pytest.mark.parametrize("width", [0.3, 0.01])
def test_a_thin_bent_density(width):
    """a is standard normal, b its square and some noise: mean of b 1, variance 2 + width squared."""
    found, made = drawn(Density.about(problem(bent(width)), np.array([0.3, 0.09])))
    a, b = found.theta.reshape(-1, 2).T
    assert a.mean() == pytest.approx(0.0, abs=0.06)
    assert a.var() == pytest.approx(1.0, rel=0.07)
    assert b.mean() == pytest.approx(1.0, rel=0.07)
    assert b.var() == pytest.approx(2 + width**2, rel=0.15)
    assert (b - a**2).std() == pytest.approx(width, rel=0.05)
    assert made.unsolved == 0
    assert (found.acceptance > 0.9).all()


def test_acceptance_mends_what_proposals_are_not():
    grid = np.linspace(-4, 4, 4001)
    weights = np.exp(-0.5 * ((grid - 1) ** 2 + (grid**3 / 4) ** 2))
    weights /= weights.sum()
    mean, square = weights @ grid, weights @ grid**2
    density = Density.about(problem(cubic), np.array([0.8, 0.0]))
    found, made = drawn(density, 4000)
    a = found.theta[..., 0].ravel()
    assert a.mean() == pytest.approx(mean, abs=0.025)
    assert a.var() == pytest.approx(square - mean**2, rel=0.06)
    assert (found.acceptance < 0.98).all()
    np.testing.assert_allclose(made.log_density, density(made.theta).log_density)


def test_what_cannot_be_simulated_is_never_sampled(line):
    function, mean, covariance = line
    half = problem(function, usable=lambda theta: theta[:, 0] > mean[0] - 0.2 * np.sqrt(covariance[0, 0]))
    found, made = drawn(Density.about(half, mean), 500)
    least = mean[0] - 0.2 * np.sqrt(covariance[0, 0])
    assert (found.theta[..., 0] > least).all()
    assert made.unsolved > 0
    beyond = np.array([[least - 0.1, mean[1]], mean])
    assert list(np.isneginf(Density.about(half, mean)(beyond).log_density)) == [True, False]


def test_nothing_to_sample_is_said(line):
    function, mean, covariance = line
    sd = np.sqrt(np.diagonal(covariance))
    narrow = Density.about(problem(function, mean + 5 * sd, mean + 5.1 * sd), mean + 5.05 * sd)
    with pytest.raises(InputError, match="beyond the bounds or cannot be simulated"):
        proposals(narrow, 100, np.random.default_rng(0))
    with pytest.raises(InputError, match="at the estimate cannot be simulated"):
        Density.about(problem(function, usable=lambda theta: np.zeros(len(theta), bool)), mean)
    flat = problem(lambda t: (np.zeros((len(t), 1, 3)), np.ones((len(t), 1, 3, 2))))
    with pytest.raises(InputError, match="leave a combination of the parameters open"):
        Density.about(flat, mean)
    nearly = np.ones((40, 3, 2)) * [1.0, 1.0] + 1e-9 * np.random.default_rng(0).normal(size=(40, 3, 2))
    with pytest.raises(InputError, match="leave a combination of the parameters open"):
        Density.about(problem(linear(nearly, np.zeros((40, 3)))), mean)
    with pytest.raises(InputError, match="leave a combination of the parameters open"):
        tempering(np.eye(2), np.ones((2, 2)))


def test_the_same_seed_gives_the_same_draws(line):
    density = Density.about(problem(line[0]), line[1])
    one, again, other = (drawn(density, 20, seed)[0].theta for seed in (4, 4, 5))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"draws": 7}, "draws: found 7"),
        ({"chains": 1}, "chains: found 1"),
        ({"warmup": 0}, "warmup: found 0"),
        ({"draws": 9.5}, "9.5"),
    ],
)
def test_numbers_of_draws_that_are_none_are_refused_before_anything_else(options, found):
    estimate: Any = None
    with pytest.raises(InputError, match=found):
        sample_posterior(estimate, **options)


def test_every_draw_and_every_one_of_the_warmup_has_a_proposal(monkeypatch):
    def asked(_density, count, *_):
        raise InputError(f"{count} proposals")

    monkeypatch.setattr(sampling.Density, "of", lambda *_: None)
    monkeypatch.setattr(sampling, "proposals", asked)
    estimate: Any = None
    with pytest.raises(InputError, match="168 proposals"):
        sample_posterior(estimate, draws=30, chains=4, warmup=12)
