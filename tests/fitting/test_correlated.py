"""What correlated residuals count beside priors: against the Bayes estimate of a linear model whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
from linear_problems import NOMINAL, design, parameters, problem, run
from scipy.linalg import toeplitz

from fitting.finish import finished, share_of_independent
from fitting.methods.least_squares import LeastSquares

SIGMA = np.array([0.02, 0.02, 0.02, 0.5])
FRAMES, RHO = 300, 0.93
TIME = np.arange(FRAMES) / FRAMES
PRIOR_SD = np.array([0.004, 0.08, 0.003])


def slow_design() -> np.ndarray:
    """(frames, 4, 3): columns that go through few cycles, as a knee's reactions to its parameters do."""
    cycles = np.array([[1.0, 1.5, 0.7], [0.5, 2.0, 1.2], [1.3, 0.4, 2.1], [0.8, 1.1, 0.3]])
    size = np.array([1.0, 0.05, 2.0]) * np.array([[0.1], [0.2], [0.15], [3.0]])
    return size * np.sin(2 * np.pi * cycles * TIME[:, None, None] + np.arange(3))


CORRELATION = toeplitz(RHO ** np.arange(FRAMES))
ROOT = np.linalg.cholesky(CORRELATION)


def solved(weighed: bool, slopes: np.ndarray, measured: np.ndarray, known) -> tuple[np.ndarray, float]:
    """Where the search ends, and what the measurements count there."""

    search = LeastSquares(problem(slopes, measured, known), 0, 1)
    state = run(search)
    if weighed:
        search, state = finished(search, state, run)
    return np.asarray(state["best_theta"]), search.problem.objective.share


@pytest.mark.slow
def test_priors_are_not_drowned():
    """Truths drawn from their prior: errors in units of the prior's width, over repeats."""
    random, slopes = np.random.default_rng(4), slow_design()
    whitened = np.linalg.solve(ROOT, (slopes / SIGMA[:, None]).reshape(FRAMES, -1)).reshape(slopes.shape)
    information = np.einsum("tmp,tmq->pq", whitened, whitened) + np.diag(PRIOR_SD**-2.0)
    errors = []
    for _ in range(60):
        truth = NOMINAL + PRIOR_SD * random.normal(size=3)
        noise = (ROOT @ random.normal(size=(FRAMES, 4))) * SIGMA
        measured = slopes @ truth + noise
        known = parameters(tuple(zip(NOMINAL, PRIOR_SD, strict=True)), half_width=60.0)
        white = np.linalg.solve(ROOT, (measured - slopes @ NOMINAL) / SIGMA)
        bayes = NOMINAL + np.linalg.solve(information, np.einsum("tmp,tm->p", whitened, white))
        found = [bayes, *(solved(again, slopes, measured, known)[0] for again in (False, True))]
        errors.append([(x - truth) / PRIOR_SD for x in found])
    best, drowned, kept = np.sqrt(np.mean(np.square(errors), axis=(0, 2)))
    assert drowned > 1.15 * best
    assert kept < 1.05 * best


def test_the_share_is_that_of_the_long_run_variance():
    """Of AR(1) noise beside a design that hardly varies: 1 / (1 + 2 sum of rho^k), with Bartlett's weights, 8 lags."""
    frames, rho = 20_000, 0.6
    random = np.random.default_rng(0)
    noise = np.zeros((frames, 4))
    draws = random.normal(size=(frames, 4)) * np.sqrt(1 - rho**2)
    for t in range(1, frames):
        noise[t] = rho * noise[t - 1] + draws[t]
    time = np.arange(frames)[:, None, None] / frames
    slopes = np.sin(2 * np.pi * time * np.array([1.0, 2.0, 3.0]) + np.arange(4)[:, None])
    target = problem(slopes, noise * SIGMA, parameters()).objective
    share = share_of_independent(target, noise * SIGMA, slopes)
    lags = np.arange(1, 9)  # four correlation lengths, each 1 / -log(rho)
    assert share == pytest.approx(1 / (1 + 2 * np.sum((1 - lags / 9) * rho**lags)), rel=0.1)
    assert share_of_independent(target, random.normal(size=(frames, 4)) * SIGMA, slopes) == 1.0


def test_without_priors_nothing_is_weighed():
    slopes = slow_design()
    measured = slopes @ NOMINAL + (ROOT @ np.random.default_rng(5).normal(size=(FRAMES, 4))) * SIGMA
    assert solved(True, slopes, measured, parameters(half_width=60.0))[1] == 1.0


def test_white_residuals_count_whole():
    slopes = design(FRAMES)
    measured = slopes @ NOMINAL + np.random.default_rng(6).normal(size=(FRAMES, 4)) * SIGMA
    known = parameters(tuple(zip(NOMINAL, PRIOR_SD, strict=True)), half_width=60.0)
    assert solved(True, slopes, measured, known)[1] == 1.0


def test_an_interrupt_before_the_second_searchs_answer_keeps_the_firsts():
    def interrupted(_):
        raise KeyboardInterrupt

    random = np.random.default_rng(2)
    measured = design() @ NOMINAL + SIGMA * random.normal(size=(40, 4))
    known = parameters(tuple(zip(NOMINAL, PRIOR_SD, strict=True)), half_width=60.0)
    search = LeastSquares(problem(design(), measured, known), 0, 1)
    first = {"best_theta": NOMINAL + 0.1 * PRIOR_SD, "stopped": "converged", "interrupted": False}
    assert finished(search, first, interrupted) == (search, {**first, "interrupted": True})
