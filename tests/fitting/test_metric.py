"""Weights of frames and covariances of noise: generalised least squares in closed form, whatever asks for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from linear_problems import CHANNELS, NOMINAL, design, objective, parameters, problem
from scipy import stats

from fitting.evaluation import Prediction
from fitting.methods.problem import Request
from fitting.metric import Metric, check_noise, covariances, level
from fitting.objective import Objective
from fitting.trials import joined_objective
from pftwin.base.errors import InputError

FRAMES = 40
COVARIANCE = np.array([[4.0, 1.2, -0.5], [1.2, 1.0, 0.3], [-0.5, 0.3, 2.5]]) * 1e-4
FORCE = 0.5
STATED = {"position": COVARIANCE, "contact": FORCE}
WEIGHTS = np.random.default_rng(5).uniform(0.2, 3.0, FRAMES)


def metric(weights: np.ndarray | None = WEIGHTS, noise: Any = STATED) -> Metric:
    found = Metric.of(weights, FRAMES, covariances(noise))
    assert found is not None
    return found


def target(measured: np.ndarray, noise: Any = STATED, **more: Any) -> Objective:
    levels = None if noise is None else {c: level(v) for c, v in noise.items()}
    return objective(measured, levels, metric=metric(noise=noise), **more)


def measured(seed: int = 2) -> np.ndarray:
    """With noise as it is stated, and two gaps."""
    random = np.random.default_rng(seed)
    data = np.einsum("tmp,p->tm", design(), NOMINAL)
    data[:, :3] += random.multivariate_normal(np.zeros(3), COVARIANCE, FRAMES) / np.sqrt(WEIGHTS)[:, None]
    data[:, 3] += random.normal(0.0, FORCE, FRAMES) / np.sqrt(WEIGHTS)
    data[3:9, :3] = data[20:23, 3] = np.nan
    return data


def value(own: Objective, at: np.ndarray) -> float:
    return float(own.value(Prediction(at[None], None, np.ones(1, bool)))[0])


def test_the_objective_is_minus_the_log_of_normal_densities() -> None:
    data, own = measured(), target(measured())
    one, other = (np.einsum("tmp,p->tm", design(), NOMINAL + off) for off in (0.0, np.array([0.01, -0.4, 0.02])))

    def worth(at: np.ndarray) -> float:
        total = 0.0
        for t, w in enumerate(WEIGHTS):
            if np.isfinite(data[t, :3]).all():
                total -= stats.multivariate_normal.logpdf(data[t, :3], at[t, :3], COVARIANCE / w)
            if np.isfinite(data[t, 3]):
                total -= stats.norm.logpdf(data[t, 3], at[t, 3], FORCE / np.sqrt(w))
        return total

    assert value(own, other) - value(own, one) == pytest.approx(worth(other) - worth(one), rel=1e-9)


@pytest.mark.parametrize("noise", [STATED, None])
@pytest.mark.parametrize("kind", ["likelihood", "paper"])
def test_its_slopes_are_finite_differences(noise: Any, kind: str) -> None:
    data, ours = measured(), problem(design(), measured(), parameters())
    of_paper = {"kind": kind, "groups": ("X", "Y", "Z"), "group_of": np.arange(3), "channels": ("position",)}
    if kind == "paper":
        data, ours = data[:, :3], problem(design()[:, :3], data, parameters())
    own = target(data, None if kind == "paper" else noise, **(of_paper if kind == "paper" else {}))
    ours = replace(ours, objective=own)
    at = NOMINAL + np.array([0.3, -9.0, 0.2])
    steps = 1e-5 * np.abs(at)
    values = ours.answer(Request(np.concatenate([at + np.diag(steps), at - np.diag(steps)]), 1)).value
    expected = (values[:3] - values[3:]) / (2 * steps)
    for want in ("gradient", "normal"):
        found = ours.answer(Request(at[None], 1, want)).gradient  # by reverse mode, and by columns
        assert found is not None
        np.testing.assert_allclose(found[0], expected, rtol=1e-6)


def test_its_minimum_is_generalised_least_squares() -> None:
    data, ours = measured(), problem(design(), measured(), parameters())
    ours = replace(ours, objective=target(data))
    normal = ours.normal(NOMINAL[None])
    step = np.linalg.solve(normal.hessian[0], -normal.gradient[0])
    information, score = np.zeros((3, 3)), np.zeros(3)
    for t, w in enumerate(WEIGHTS):
        for columns, precision in ((slice(0, 3), np.linalg.inv(COVARIANCE)), (slice(3, 4), np.eye(1) / FORCE**2)):
            if np.isfinite(data[t, columns]).all():
                a = design()[t, columns]
                information += w * a.T @ precision @ a
                score += w * a.T @ precision @ (data[t, columns] - a @ NOMINAL)
    np.testing.assert_allclose(normal.hessian[0], information, rtol=1e-9)
    np.testing.assert_allclose(step, np.linalg.solve(information, score), rtol=1e-7)


def test_a_weight_counts_as_so_many_frames() -> None:
    data = measured()
    twice = np.where(np.arange(FRAMES) % 3 == 0, 2.0, 1.0)
    weighted = replace(target(data), metric=metric(twice))
    again = np.concatenate([data, data[::3]])
    plain = replace(target(data), measured=again, present=np.isfinite(again), metric=metric(None))
    plain = replace(plain, metric=Metric(np.ones(len(again)), metric().channels))
    at = np.einsum("tmp,p->tm", design(), NOMINAL + 0.02)
    assert value(weighted, at) == pytest.approx(value(plain, np.concatenate([at, at[::3]])), rel=1e-12)


def test_trials_keep_their_own_weights() -> None:
    data = measured()
    first, second = target(data), replace(objective(data[:25], {"position": 0.01, "contact": FORCE}))
    first = replace(first, noise={"position": level(COVARIANCE), "contact": FORCE})
    both = joined_objective(
        [first, replace(second, noise=first.noise, metric=first.metric and first.metric.at(slice(25)))]
    )
    at = np.einsum("tmp,p->tm", design(), NOMINAL + 0.02)
    joined = np.concatenate([at, np.zeros((1, 4)), at[:25]])
    parts = value(first, at) + value(replace(second, noise=first.noise, metric=metric().at(slice(25))), at[:25])
    assert value(both, joined) == pytest.approx(parts, rel=1e-12)
    assert [value(own, at[:n]) for own, n in zip(both.trials, (FRAMES, 25), strict=True)] == pytest.approx(
        [value(first, at), parts - value(first, at)]
    )


def test_a_trial_without_weights_counts_each_frame_alike() -> None:
    data = measured()
    weighted, plain = target(data), objective(data[:25], {"position": level(COVARIANCE), "contact": FORCE})
    weighted = replace(weighted, metric=Metric(np.sqrt(WEIGHTS), {}))
    at = np.einsum("tmp,p->tm", design(), NOMINAL + 0.02)
    both = joined_objective([weighted, plain])
    found = value(both, np.concatenate([at, np.zeros((1, 4)), at[:25]]))
    assert found == pytest.approx(value(weighted, at) + value(plain, at[:25]), rel=1e-12)


def test_the_level_of_a_covariance_is_that_of_its_columns() -> None:
    assert level(np.diag([9.0, 16.0, 11.0])) == pytest.approx(np.sqrt(12.0))
    assert level(0.3) == 0.3


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ({"position": 0.1}, "no noise of 'contact'"),
        ({"position": -0.1, "contact": 1.0}, "found -0.1"),
        ({"position": np.eye(2), "contact": 1.0}, r"shape \(2, 2\).*or a covariance \(3, 3\)"),
        ({"position": 0.1, "contact": np.eye(1)}, r"contact: found numbers of shape \(1, 1\)"),
        ({"position": np.diag([1.0, 1.0, -1.0]), "contact": 1.0}, "not a covariance"),
        ({"position": np.triu(np.ones((3, 3))) + np.eye(3), "contact": 1.0}, "not a covariance"),
        ({"position": np.full((3, 3), np.nan), "contact": 1.0}, "not a covariance"),
    ],
)
def test_noise_that_is_none_is_refused(noise: Any, said: str) -> None:
    with pytest.raises(InputError, match=f"(?s){said}"):
        check_noise(noise, CHANNELS, (3, 1))
