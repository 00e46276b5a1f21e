"""Posteriors learned from simulations against closed forms: linear models with correlated noise and nuisance."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from linear_problems import NOMINAL, parameters, problem
from scipy.linalg import toeplitz

from fitting.channel_checks import LIMITS
from fitting.evaluation import Prediction
from fitting.inference.infer import Inferred, check_size, infer
from fitting.inference.learning import Answer, learn
from fitting.inference.nuisance_draws import with_nuisance
from fitting.inference.recordings import Noise
from fitting.inference.region import Region
from fitting.methods.problem import Problem
from fitting.nuisance import EXACT, Nuisance
from fitting.outcome import Outcome
from fitting.parameters import Parameters
from fitting.sensors import sensed
from pftwin.base.errors import InputError

FRAMES, RHO = 200, 0.8
SIGMA = np.array([0.02, 0.02, 0.02, 0.5])
PRIOR = (0.37, 0.02)  # of the third parameter, which is nuisance
TRUTH = np.array([1.23, -30.4, 0.4])
HALF_WIDTH = 3.0
OFF = Nuisance(placement=0.03, force_bias=0.8)


def slopes() -> np.ndarray:
    """(frames, 4, 3): reactions that go through few cycles, all of unlike size."""
    time = np.arange(FRAMES)[:, None, None] / FRAMES
    cycles = np.array([[1.0, 1.5, 0.7], [0.5, 2.0, 1.2], [1.3, 0.4, 2.1], [0.8, 1.1, 0.3]])
    size = np.array([1.0, 0.05, 2.0]) * np.array([[0.1], [0.2], [0.15], [3.0]])
    return size * np.sin(2 * np.pi * cycles * time + np.arange(3))


def measured(seed: int, off: float = 0.0) -> np.ndarray:
    """With noise, and so many of `OFF`'s deviations off throughout."""
    root = np.linalg.cholesky(toeplitz(RHO ** np.arange(FRAMES)))
    noise = root @ np.random.default_rng(seed).normal(size=(FRAMES, 4)) * SIGMA
    return slopes() @ TRUTH + noise + off * np.array([OFF.placement] * 3 + [OFF.force_bias])


def known() -> Parameters:
    items = parameters((None, None, PRIOR), HALF_WIDTH).items
    return Parameters((*items[:2], replace(items[2], kind="friction")))


def linear(seed: int, stated: bool = True, off: float = 0.0) -> Problem:
    noise = {"position": SIGMA[0], "contact": SIGMA[3]} if stated else None
    return problem(slopes(), measured(seed, off), known(), noise)


def bayes(seed: int, sensors: Nuisance = EXACT, off: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The posterior's mean and covariance in closed form: generalised least squares with the prior. An error that stays
    the same throughout is the same variance between all frames."""
    information, pull = np.diag([0, 0, PRIOR[1] ** -2]), np.array([0, 0, PRIOR[0] * PRIOR[1] ** -2])
    same = np.array([sensors.placement] * 3 + [sensors.force_bias])
    for column, (sd, constant) in enumerate(zip(SIGMA, same, strict=True)):
        root = np.linalg.cholesky(sd**2 * toeplitz(RHO ** np.arange(FRAMES)) + constant**2)
        a, b = (np.linalg.solve(root, x[:, column]) for x in (slopes(), measured(seed, off)))
        information, pull = information + a.T @ a, pull + a.T @ b
    covariance = np.linalg.inv(information)
    return covariance @ pull, covariance


@cache
def found(
    seed: int = 3, stated: bool = True, sensors: Nuisance = EXACT, off: float = 0.0, simulations: int = 3000
) -> Inferred:
    case = linear(seed, stated, off)
    return infer(case, sensors, seed=1, simulations=simulations, rounds=6, report=lambda entry, most: None)


@pytest.mark.slow
def test_the_posterior_is_that_of_bayes():
    mean, covariance = bayes(3)
    sd = np.sqrt(np.diagonal(covariance))
    draws = found().answer.draws
    assert (np.abs(draws.mean(axis=0) - mean) < 0.35 * sd).all(), (draws.mean(axis=0) - mean) / sd
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.3)  # learned from 3,000 simulations
    ours, theirs = np.corrcoef(draws.T), covariance / np.outer(sd, sd)
    np.testing.assert_allclose(ours, theirs, atol=0.15)
    assert found().reason == "the posterior no longer changes"
    assert found().answer.distance < LIMITS["simulated"][0]
    assert found().answer.level == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_a_recording_of_sensors_that_are_off_is_answered_as_bayes_has_it():
    """Taken as exact, they would put both parameters seven deviations off and more."""
    mean, covariance = bayes(3, OFF, off=2.0)
    sd = np.sqrt(np.diagonal(covariance))
    assert (np.abs(bayes(3, off=2.0)[0] - mean)[:2] > 7 * sd[:2]).all()
    draws = found(sensors=OFF, off=2.0, simulations=6000).answer.draws
    assert (np.abs(draws.mean(axis=0) - mean) < 0.35 * sd).all(), (draws.mean(axis=0) - mean) / sd
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.3)


@pytest.mark.slow
def test_noise_that_is_not_stated_is_found():
    """As large as it came out in this recording: two hundred correlated frames are worth some twenty."""
    noise, there = found(stated=False).noise, measured(3) - slopes() @ TRUTH
    np.testing.assert_allclose(noise.deviations, np.sqrt(np.mean(there**2, axis=0)), rtol=0.25)
    np.testing.assert_allclose(noise.correlations, RHO, atol=0.12)


@pytest.mark.slow
def test_measurements_that_no_simulation_resembles_are_strange():
    """Ten times as far as the bounds reach along what the second parameter does."""
    far = linear(3)
    moved = far.objective.measured + 10 * HALF_WIDTH * slopes()[..., 1]
    strange = replace(far, objective=replace(far.objective, measured=moved))
    random = np.random.default_rng(0)
    region, noise = Region(far.parameters), Noise.initial(far.objective)
    theta = region.drawn(600, random)
    nothing = np.zeros((FRAMES, 4), np.float32)
    for case, expected in ((far, False), (strange, True)):
        residuals = case.objective.residuals(case.evaluator.values(theta, 1).values).astype(np.float32)
        far_off = learn(region, theta, residuals, nothing, case.objective, noise, random).scaled_summaries(
            nothing[None]
        )
        assert (np.abs(far_off).max() > LIMITS["simulated"][0]) is np.bool_(expected)


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [EXACT, OFF])
def test_nuisance_given_what_is_asked_for_is_that_of_bayes(sensors):
    """Linear recordings of which what is asked for is known to be elsewhere: the conditional normal distribution."""
    base, random = linear(3), np.random.default_rng(8)
    region, nothing = Region(base.parameters), np.zeros((FRAMES, 4), np.float32)
    theta = region.drawn(1000, random)
    values = sensed(base.evaluator.values(theta, 1).values, sensors, base, random)
    recordings = base.objective.residuals(values).astype(np.float32)
    known_noise = Noise(SIGMA, np.full(4, RHO), 1.0)
    learned = learn(region, theta, recordings, nothing, base.objective, known_noise, random)
    mean, covariance = bayes(3, sensors)
    deviations = np.sqrt(np.diagonal(covariance)[:2])
    asked = mean[:2] + deviations * np.repeat([[1.0, -2.0], [0.0, 0.5]], 4000, axis=0)
    draws = with_nuisance(base, sensors, base.objective, learned, nothing, asked, 1, random)
    np.testing.assert_array_equal(draws[:, :2], asked)
    gain = np.linalg.solve(covariance[:2, :2], covariance[:2, 2])
    expected = mean[2] + (asked - mean[:2]) @ gain
    sd = float(np.sqrt(covariance[2, 2] - covariance[2, :2] @ gain))
    for half in (slice(0, 4000), slice(4000, 8000)):
        assert draws[half, 2].mean() == pytest.approx(expected[half].mean(), abs=0.3 * sd)
        assert draws[half, 2].std() == pytest.approx(sd, rel=0.15)


def test_nuisance_that_all_lies_at_its_bound_stays_there():
    """Measurements ask for far more of two of twenty numbers than their bounds allow. Then all knees that are simulated
    again are alike in them, and tell nothing of what they do: what regression makes of that is rounding, not zero."""
    items, random = known().items, np.random.default_rng(8)
    others = [replace(items[2], name=f"c{i}") for i in range(20)]
    others[5:7] = [replace(item, lower=0.25, upper=0.5) for item in others[5:7]]
    many, reactions = Parameters((*items[:2], *others)), random.normal(size=(FRAMES, 4, 22))
    truth = np.array([*TRUTH[:2], *20 * [0.37]])
    truth[7:9] = 5.0
    far = problem(reactions, reactions @ truth, many, {"position": SIGMA[0], "contact": SIGMA[3]})
    directions, nothing = 1e3 * random.normal(size=(FRAMES * 4, 80)), np.zeros((FRAMES, 4), np.float32)
    learned = SimpleNamespace(
        scaled_summaries=lambda recordings: recordings.reshape(len(recordings), -1) @ directions,
        middle=np.zeros(80),
        added=SimpleNamespace(root=np.eye(80)),
    )
    asked = TRUTH[:2] + 0.01 * random.normal(size=(400, 2))
    with np.errstate(over="raise", invalid="raise"):
        draws = with_nuisance(far, EXACT, far.objective, learned, nothing, asked, 1, random)
    assert np.isfinite(draws).all()
    assert ((draws[:, 7:9] >= 0.25) & (draws[:, 7:9] <= 0.5)).all()


@pytest.mark.parametrize("runs", [True, False])
def test_where_the_means_do_not_run_the_nearest_draw_stands(runs):
    base, random = linear(3), np.random.default_rng(5)
    draws = NOMINAL + np.array([0.2, 1.5, 0.01]) * random.normal(size=(500, 3))
    mean = draws.mean(axis=0)

    def values(theta: np.ndarray, substeps: int) -> Prediction:
        seen = base.evaluator.with_slopes(theta, substeps)
        return seen._replace(usable=np.array([runs or np.abs(row - mean).max() > 1e-9 for row in theta]))

    evaluator = SimpleNamespace(values=values, step_errors=lambda theta, substeps, slopes: {})
    noise, history = Noise(SIGMA, np.full(4, RHO), 1.0), [{"iteration": 1, "evaluations": 500.0}]
    found = Inferred(Answer(draws, 1.0, 1.0), noise, 500, 3, 1, history, "the posterior no longer changes")
    outcome = Outcome.of_simulations(replace(base, evaluator=evaluator), found, 0, LIMITS)
    distance = np.linalg.norm((draws - mean) / draws.std(axis=0), axis=1)
    np.testing.assert_allclose(outcome.theta, mean if runs else draws[np.argmin(distance)])
    assert [doubt[:36] for doubt in outcome.doubts] == ([] if runs else ["the posterior's means give no finite"])
    assert outcome.prediction.slopes is not None
    np.testing.assert_allclose(outcome.prediction.slopes, slopes()[None], atol=1e-8 * np.abs(slopes()).max())
    assert (outcome.facts["evaluations"], outcome.facts["dropped"]) == (500, 3)
    assert outcome.noise == {"position": pytest.approx(SIGMA[0]), "contact": pytest.approx(SIGMA[3])}


def test_what_cannot_be_learned_is_refused():
    with pytest.raises(InputError, match="at least 1000"):
        check_size(known(), 100, 800)
    items = tuple(replace(known().items[0], name=f"a{i}") for i in range(13))
    with pytest.raises(InputError, match="at most 12"):
        check_size(Parameters(items), 1000, 800)
    check_size(Parameters((*items[:12], *(replace(i, kind="friction") for i in items))), 1000, 800)
    with pytest.raises(InputError, match="at most 1,000 simulations"):
        check_size(known(), 8000, 100_000)


@pytest.mark.slow
def test_an_interrupt_keeps_the_last_whole_round():
    def interrupt(entry: dict[str, float], most: int) -> None:
        if entry["iteration"] == 2:
            raise KeyboardInterrupt

    kept = infer(linear(3), EXACT, seed=1, simulations=1000, rounds=4, report=interrupt)
    assert kept.interrupted
    assert len(kept.history) == 2
    assert kept.answer.draws.shape == (2000, 3)
    assert NOMINAL[0] - HALF_WIDTH < kept.answer.draws[:, 0].mean() < NOMINAL[0] + HALF_WIDTH
