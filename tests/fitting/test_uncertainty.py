"""Covariances against closed forms of linear models, and against how estimates really scatter."""

from __future__ import annotations

import numpy as np
import pytest
from linear_problems import NOMINAL, design, objective, parameters, scaled
from made_estimates import made_estimate
from scipy.linalg import toeplitz
from scipy.optimize import curve_fit

from fitting.uncertainty import Undetermined, inverse_information, serial_correlation, uncertainty

SIGMA = np.array([0.02, 0.02, 0.02, 0.5])


def sure_of(slopes, residuals, known=None, theta=NOMINAL):
    target = objective(np.where(np.isfinite(residuals), 0.0, np.nan))
    return uncertainty(target, parameters() if known is None else known, np.nan_to_num(residuals), slopes, theta)


def white(slopes, seed=1):
    return np.random.default_rng(seed).normal(size=slopes.shape[:2]) * SIGMA


def test_white_residuals_give_the_covariance_of_weighted_least_squares():
    slopes = design()
    found = sure_of(slopes, white(slopes))
    flat = slopes.reshape(-1, 3)
    noise = np.tile(SIGMA, len(slopes))
    _, expected = curve_fit(lambda _, *t: flat @ t, None, flat @ NOMINAL, NOMINAL, noise, absolute_sigma=True)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-5)


def test_what_was_not_measured_tells_nothing():
    slopes = design()
    residuals = white(slopes)
    residuals[5:20, :3] = np.nan
    residuals[30, 3] = np.nan
    a = scaled(slopes, np.isfinite(residuals))
    np.testing.assert_allclose(sure_of(slopes, residuals).covariance, np.linalg.inv(a.T @ a), rtol=1e-9)


def test_priors_count_as_measurements_of_the_parameters():
    """A row more of the design for each: 1 / standard deviation."""
    slopes = design()
    rows = np.concatenate([scaled(slopes), [[1 / 0.003, 0, 0], [0, 0, 1 / 0.002]]])
    found = sure_of(slopes, white(slopes), parameters(((1.0, 0.003), None, (0.5, 0.002))))
    np.testing.assert_allclose(found.covariance, np.linalg.inv(rows.T @ rows), rtol=1e-9)


def test_the_condition_is_of_relative_parameters():
    """Singular values of the design times the parameters; a parameter that is 0 counts by its range."""
    slopes = design()
    for theta, size in ((NOMINAL, np.abs(NOMINAL)), (np.array([0.0, -30.0, 0.4]), np.array([2000.0, 30.0, 0.4]))):
        singular = np.linalg.svd(scaled(slopes) * size, compute_uv=False)
        found = sure_of(slopes, white(slopes), theta=theta)
        assert found.condition == pytest.approx((singular[0] / singular[-1]) ** 2, rel=1e-6)


AR, FRAMES = 0.8, 400


@pytest.mark.parametrize("seed", range(6))
def test_parameters_of_which_only_the_product_matters_are_not_known_exactly(seed):
    """Their derivatives are proportional, up to rounding, in residuals that are correlated in time."""
    slopes = smooth_design() + 0.01 * np.random.default_rng(seed).normal(size=(FRAMES, 4, 3))
    slopes[..., 1] = slopes[..., 0] * (NOMINAL[0] / NOMINAL[1]) * (1 + 1e-16 * seed)
    residuals = correlated(1, seed)[0] * SIGMA
    found = sure_of(slopes, residuals)
    deviations = np.sqrt(np.diagonal(found.covariance)) / np.abs(NOMINAL)
    assert found.serial > 0.5
    assert (deviations[:2] > 100).all()
    alone = sure_of(slopes[..., [0, 0, 2]] * [1, 0, 1], residuals)  # with the second one fixed
    assert found.covariance[2, 2] == pytest.approx(alone.covariance[2, 2], rel=1e-6)


def correlated(draws, seed=0):
    """First-order autoregressive noise of standard deviation 1 (draws, frames, 4), from its exact covariance."""
    root = np.linalg.cholesky(toeplitz(AR ** np.arange(FRAMES)))
    return np.einsum("ts,dsm->dtm", root, np.random.default_rng(seed).normal(size=(draws, FRAMES, 4)))


def smooth_design():
    """Slow functions of time: what correlated noise is mistaken for."""
    t = np.arange(FRAMES)[:, None, None] / FRAMES
    phase = np.arange(12).reshape(1, 4, 3)
    return 0.1 * np.cos(2 * np.pi * (1 + phase % 3) * t + phase) * np.array([[1], [0.7], [1.3], [20]])


@pytest.mark.parametrize("priors", [(None, None, None), ((NOMINAL[0], 0.02), None, None)])
def test_correlated_residuals_widen_it_to_how_estimates_scatter(priors):
    """The sandwich (A'A + P)^-1 (A' Omega A + P) (A'A + P)^-1 with the noise's own covariance Omega; Bartlett's
    weights over a few correlation lengths leave out some tenths of it."""
    slopes, known = smooth_design(), parameters(priors)
    a = slopes / SIGMA[:, None]
    precision = np.diag([0.0 if p is None else p[1] ** -2 for p in priors])
    inverse = np.linalg.inv(np.einsum("tmp,tmq->pq", a, a) + precision)
    middle = np.einsum("tmp,tmq->pq", a, np.tensordot(toeplitz(AR ** np.arange(FRAMES)), a, 1)) + precision
    exact = inverse @ middle @ inverse
    found = np.mean([sure_of(slopes, z * SIGMA, known).covariance for z in correlated(60)], axis=0)
    ratio = np.linalg.eigvals(np.linalg.solve(exact, found)).real
    assert 0.7 < ratio.min() <= ratio.max() < 1.1, ratio
    assert np.linalg.eigvals(np.linalg.solve(inverse, exact)).real.max() > 4  # as if white it would be far off


@pytest.mark.parametrize("deviation", [None, 1e-3])
def test_the_sandwich_is_newey_and_wests_sum(deviation):
    """Written out pair by pair of frames: weight 1 - lag / (lags + 1), scores about their mean; what is known
    beforehand, here as well as by the measurements, is independent of them."""
    slopes = smooth_design()
    z = correlated(1, seed=3)[0]
    prior = None if deviation is None else (NOMINAL[0], deviation)
    precision = np.diag([0.0 if deviation is None else deviation**-2, 0.0, 0.0])
    found = sure_of(slopes, z * SIGMA, parameters((prior, None, None)))
    a = slopes / SIGMA[:, None]
    score = np.einsum("tmp,tm->tp", a, z)
    score = score - score.mean(axis=0)
    lags = int(np.ceil(-4 / np.log(np.sum(z[1:] * z[:-1]) / np.sum(z**2))))
    apart = np.abs(np.subtract.outer(np.arange(FRAMES), np.arange(FRAMES)))
    middle = score.T @ np.maximum(1 - apart / (lags + 1), 0) @ score + precision
    inverse = np.linalg.inv(np.einsum("tmp,tmq->pq", a, a) + precision)
    np.testing.assert_allclose(found.covariance, inverse @ middle @ inverse, rtol=1e-8)
    assert found.serial == pytest.approx(AR, abs=0.05)


def test_serial_correlation_skips_what_was_not_measured():
    """Only neighbours that were both measured make a product; squares are of all that was."""
    z = np.array([[1.0, 2.0], [0.0, -1.0], [3.0, 4.0], [-2.0, 1.0]])
    present = np.array([[True, True], [False, True], [True, True], [True, True]])
    assert serial_correlation(z, present) == pytest.approx((-2 - 4 - 6 + 4) / (1 + 9 + 4 + 4 + 1 + 16 + 1))
    assert serial_correlation(np.zeros((3, 1)), np.ones((3, 1), bool)) == 0


def test_an_inverse_of_unlike_units():
    a = np.array([[1e9, 10.0, 0], [10.0, 1e-6, 0], [0, 0, 4.0]])
    exact = np.array([[1e-6 / 900, -10 / 900, 0], [-10 / 900, 1e9 / 900, 0], [0, 0, 0.25]])
    np.testing.assert_allclose(inverse_information(a), exact, rtol=1e-6, atol=1e-12)
    with np.errstate(over="ignore"):
        assert inverse_information(np.diag([1.0, 0.0]))[1, 1] > 1e200


def test_undetermined_combinations_are_counted_and_named():
    """Of four parameters, in deviations of what was known: K1 against K2 is open, and friction alone."""
    names, known = ("K1", "L1", "K2", "mu"), np.array([17.0, 0.011, 58.0, 0.3])
    against = np.array([0.6, 0.0, -0.8, 0.0])
    covariance = np.diag([1e-4, 0.04, 1e-4, 1.0]) + 0.95**2 * np.outer(against, against)
    assert Undetermined.of(names, known, covariance * np.outer(known, known)) == (2, ("mu", "K2", "K1"))
    posterior = np.diag([1e-4, 0.04, 1e-4, 0.64]) + 0.8**2 * np.outer(against, against)
    assert Undetermined.of(names, known, posterior * np.outer(known, known)) == (0, ())
    infinite = np.diag([0.01, np.inf, 0.01, 0.9]) * np.outer(known, known)
    assert Undetermined.of(names, known, infinite) == (2, ("L1", "mu"))


@pytest.mark.parametrize("seed", range(5))
def test_parameters_that_are_open_are_the_same_whatever_rounding_makes_of_them(seed):
    """Draws of three parameters from their bounds, and of a fourth that is determined."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (2000, 4)) * [1.0, 1.0, 1.0, 0.1]
    found = Undetermined.of(("a", "b", "c", "d"), np.full(4, 1 / np.sqrt(3)), np.cov(drawn.T))
    assert found.count == 3
    assert set(found.names) == {"a", "b", "c"}


def test_an_estimate_says_how_many_combinations_are_determined():
    numbers = {"K1": (150.0, 2.0), "L1": (0.14, 0.001), "K2": (620.0, 200.0)}
    assert made_estimate(numbers).undetermined == (1, ("K2",))
    said = "the measurements determine 2 of 3 combinations of the requested parameters; the others are hardly known"
    assert f"{said} beyond bounds and priors (K2)" in made_estimate(numbers).remarks()
    assert not any(said in remark for remark in made_estimate(numbers, doubts=["late"]).remarks())
    assert made_estimate(numbers, priors={"K1": (150.0, 2.1)}).undetermined == (2, ("K1", "K2"))
    assert made_estimate({"K1": (150.0, 2.0)}).undetermined == (0, ())
