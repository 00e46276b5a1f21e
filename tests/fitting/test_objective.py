"""Objectives against scipy: normal likelihoods, robust losses, turns, degrees of freedom, finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from linear_problems import CHANNELS, NOISE, NOMINAL, design, objective, parameters, problem
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fitting.evaluation import Prediction
from fitting.methods.problem import Request

SIGMA = np.array([0.02, 0.02, 0.02, 0.5])


def measured(seed=2, gaps=True):
    data = np.einsum("tmp,p->tm", design(), NOMINAL) + np.random.default_rng(seed).normal(size=(40, 4)) * SIGMA
    if gaps:
        data[3:9, :3] = data[20:23, 3] = np.nan
    return data


def predicted(values):
    return Prediction(values[None], None, np.ones(1, bool))


def test_known_noise_is_minus_a_normal_log_likelihood():
    data, target = measured(), objective(measured())
    one, other = (np.einsum("tmp,p->tm", design(), NOMINAL + off) for off in (0.0, np.array([0.01, -0.4, 0.02])))
    worth = [-np.nansum(stats.norm.logpdf(data, at, SIGMA)) for at in (one, other)]
    values = [target.value(predicted(at))[0] for at in (one, other)]
    assert values[1] - values[0] == pytest.approx(worth[1] - worth[0], rel=1e-9)


def test_unknown_noise_is_the_likelihood_at_each_channels_best_noise():
    data, target = measured(), objective(measured(), None)

    def worth(at):
        total = 0.0
        for columns in (slice(0, 3), slice(3, 4)):
            r = (data - at)[:, columns]
            r = r[np.isfinite(r)]
            total -= stats.norm.logpdf(r, 0, np.sqrt(np.mean(r**2))).sum()
        return total

    one, other = (np.einsum("tmp,p->tm", design(), NOMINAL + off) for off in (0.0, np.array([0.1, -4.0, 0.2])))
    change = target.value(predicted(other))[0] - target.value(predicted(one))[0]
    assert change == pytest.approx(worth(other) - worth(one), rel=1e-6)


def test_the_papers_objective_is_the_sum_of_three_root_mean_squares():
    data = measured()[:, :3]
    target = objective(
        data, None, kind="paper", channels=("position",), groups=("X", "Y", "Z"), group_of=np.array([0, 1, 2])
    )
    at = np.nan_to_num(data) + np.array([0.003, -0.004, 0.02])
    assert target.value(predicted(at))[0] == pytest.approx(0.027, rel=1e-6)
    assert target.unit == "m"


@pytest.mark.parametrize(("loss", "scale"), [("linear", 1.0), ("huber", 1.345), ("soft_l1", 1.0)])
def test_losses_are_scipys(loss, scale):
    data = measured(gaps=False)
    data[::7] += 5 * SIGMA
    at = np.einsum("tmp,p->tm", design(), NOMINAL)
    cost = least_squares(lambda _: ((at - data) / SIGMA).ravel(), [0.0], loss=loss, f_scale=scale, max_nfev=1).cost
    assert objective(data, loss=loss).value(predicted(at))[0] == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize(("noise", "loss"), [(NOISE, "linear"), (NOISE, "huber"), (NOISE, "soft_l1"), (None, "linear")])
def test_gradients_are_finite_differences(noise, loss):
    known = parameters(((1.0, 0.05), None, (0.3, 0.02)))
    at = NOMINAL + np.array([0.3, -9.0, 0.2])
    ours = problem(design(), measured(), known, noise, loss)
    answer = ours.answer(Request(at[None], 1, "normal"))
    steps = 1e-5 * np.abs(at)
    around = np.concatenate([at + np.diag(steps), at - np.diag(steps)])
    values = ours.answer(Request(around, 1)).value
    expected = (values[:3] - values[3:]) / (2 * steps)
    np.testing.assert_allclose(answer.gradient[0], expected, rtol=1e-5)
    backwards = ours.answer(Request(np.stack([at, np.full(3, np.nan)]), 1, "gradient"))
    np.testing.assert_allclose(backwards.gradient, [expected, np.zeros(3)], rtol=1e-5)
    np.testing.assert_allclose(backwards.value, [ours.answer(Request(at[None], 1)).value[0], np.inf])


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_the_papers_objective_has_its_gradient(scale):
    """Also where the fit is as good as the files' last digits, and the objective is rounded off."""
    data = measured()[:, :3]
    groups = {"channels": ("position",), "groups": ("X", "Y", "Z"), "group_of": np.array([0, 1, 2])}
    target = objective(data, None, kind="paper", **groups)
    at = np.nan_to_num(data) + np.random.default_rng(5).normal(size=data.shape) * scale * np.array([0.003, 0.01, 0.02])
    pull = target.pull(at[None])
    assert pull is not None
    way = np.random.default_rng(6).normal(size=data.shape)
    up, down = (target.value(predicted(at + h * way))[0] for h in (scale * 1e-7, -scale * 1e-7))
    assert float(np.nansum(pull[0] * way)) == pytest.approx((up - down) / (scale * 2e-7), rel=1e-5)


def test_the_gauss_newton_hessian_of_a_linear_model_with_priors_is_exact():
    known = parameters(((1.0, 0.05), None, None))
    ours = problem(design(), measured(gaps=False), known)
    rows = np.concatenate([(design() / SIGMA[:, None]).reshape(-1, 3), [[1 / 0.05, 0, 0]]])
    np.testing.assert_allclose(ours.answer(Request(NOMINAL[None], 1, "normal")).hessian[0], rows.T @ rows, rtol=1e-9)


def test_noise_counts_the_parameters_that_were_fitted():
    """One channel: the sum of squares over n - p, unbiased; p is shared out by the channels' numbers."""
    one = objective(np.zeros((20, 3)), channels=("position",), groups=("position",), group_of=np.zeros(3, int))
    squares = np.random.default_rng(0).normal(size=(20, 3))
    expected = np.sqrt(np.sum(squares**2) / (60 - 7))
    assert one.noise_of(squares, 7)["position"] == pytest.approx(expected)
    both = objective(np.zeros((20, 4))).noise_of(np.ones((20, 4)), 8)
    assert both == pytest.approx({"position": np.sqrt(60 / (60 - 6)), "contact": np.sqrt(20 / (20 - 2))})


def test_noise_is_unbiased_over_many_fits():
    slopes = design(6)
    flat = slopes.reshape(-1, 3) / np.tile(SIGMA, 6)[:, None]
    hat = flat @ np.linalg.pinv(flat)
    z = np.random.default_rng(1).normal(size=(4000, 24))
    left = ((z - z @ hat) * np.tile(SIGMA, 6)).reshape(-1, 6, 4)
    target = objective(np.zeros((6, 4)), None)
    found = np.array([[target.noise_of(r, 3)[c] ** 2 for c in CHANNELS] for r in left]).mean(axis=0)
    scaled = found / np.array([0.02, 0.5]) ** 2
    assert (18 * scaled[0] + 6 * scaled[1]) / 24 == pytest.approx(1.0, abs=0.02)


def turning(rotations, **more):
    q = np.roll(rotations.as_quat(), 1, axis=1)
    group_of = np.zeros(3, int)
    target = objective(
        q,
        {"orientation": 0.005},
        channels=("orientation",),
        groups=("orientation",),
        group_of=group_of,
        present=np.ones((len(q), 3), bool),
        **more,
    )
    return q, target


def test_turns_are_twice_the_sine_of_half_the_angle_about_their_axis_in_either_quaternion():
    random = np.random.default_rng(3)
    base = Rotation.random(5, random_state=4)
    off = random.normal(scale=0.2, size=(5, 3))
    angle = np.linalg.norm(off, axis=1, keepdims=True)
    q, target = turning(base)
    turned = np.roll((base * Rotation.from_rotvec(off)).as_quat(), 1, axis=1)
    for sign in (1.0, -1.0):
        found = target.residuals(sign * turned[None])[0]
        sizes = np.linalg.norm(found, axis=1)
        np.testing.assert_allclose(sizes, 2 * np.sin(angle[:, 0] / 2), rtol=1e-9)
        np.testing.assert_allclose(found / sizes[:, None], off / angle, atol=1e-9)
        expected = 0.5 * np.sum(found**2) / 0.005**2
        assert target.value(predicted(sign * turned))[0] == pytest.approx(expected)
    np.testing.assert_allclose(target.residuals(-q[None]), 0, atol=1e-12)


def test_the_pull_of_positions_turns_and_forces_is_the_values_derivative():
    random = np.random.default_rng(5)
    base = Rotation.random(4, random_state=6)
    q = np.roll(base.as_quat(), 1, axis=1)
    data = np.concatenate([random.normal(size=(4, 3)), q, random.normal(size=(4, 1))], axis=1)
    target = objective(
        data,
        {"position": 0.3, "orientation": 0.1, "contact": 2.0},
        channels=("position", "orientation", "contact"),
        groups=("position", "orientation", "contact"),
        group_of=np.array([0, 0, 0, 1, 1, 1, 2]),
        present=np.ones((4, 7), bool),
    )
    at = data + 0.1 * random.normal(size=data.shape)
    found = target.pull(at[None])[0]
    for i, j in np.ndindex(*at.shape):
        step = np.zeros_like(at)
        step[i, j] = 1e-6
        slope = (target.value(predicted(at + step))[0] - target.value(predicted(at - step))[0]) / 2e-6
        assert found[i, j] == pytest.approx(slope, rel=1e-5, abs=1e-6), (i, j)
