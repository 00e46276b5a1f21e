"""Levenberg-Marquardt on models whose answer and whose decrease are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_problems import NOMINAL, design, parameters, problem, scaled
from scipy.optimize import lsq_linear

from fitting.methods.least_squares import LeastSquares
from fitting.methods.problem import ProblemAnswer, bounded_steps
from fitting.parameters import Parameters


def searched(ours, seed=0, starts=6):
    search = LeastSquares(ours, seed, starts)
    state = {**search.begin(), "asked": 0}
    while state["stopped"] is None:
        request = search.ask(state)
        search.tell(state, request, ours.answer(request))
        state["asked"] += 1
    return state


def test_the_decrease_it_promises_is_a_quadratics_own():
    """f(u) = g'u + u'Hu / 2 along its steps, for every start and every damping."""
    random = np.random.default_rng(0)
    search = LeastSquares(problem(design(), np.zeros((40, 4)), parameters()), 0, 2)
    root = random.normal(size=(2, 3, 3))
    hessian, gradient = root @ np.swapaxes(root, 1, 2), 0.1 * random.normal(size=(2, 3))
    u = random.uniform(0.45, 0.55, size=(2, 3))
    state = {**search.begin(), "u": u, "gradient": gradient, "hessian": hessian}
    _, at, damping, promised = search._trials(state)
    step = at - u[:, None]
    after = np.einsum("plk,pk->pl", step, gradient) + 0.5 * np.einsum("plk,pkj,plj->pl", step, hessian, step)
    np.testing.assert_allclose(promised, -after, rtol=1e-9)
    assert (promised > 0).all()
    assert promised.shape == (2, 8)
    assert (np.diff(damping, axis=1) > 0).all()
    free = np.abs(step).max(axis=-1) < 0.39  # those that were not shortened
    for i, k in zip(*np.nonzero(free), strict=True):
        matrix = hessian[i] + damping[i, k] * np.diag(np.diagonal(hessian[i]))
        np.testing.assert_allclose(matrix @ step[i, k], -gradient[i], rtol=1e-6, atol=1e-9)


def test_derivatives_are_taken_over_to_shares_of_the_range():
    """By the chain rule with theta(u): g_u = D g, H_u = D H D, with D by differences of theta."""
    ours = problem(design(), np.zeros((40, 4)), parameters(half_width=3.0))
    search = LeastSquares(ours, 0, 2)
    state = search.begin()
    u, request = state["u"].copy(), search.ask(state)
    random = np.random.default_rng(4)
    root = random.normal(size=(2, 3, 3))
    gradient, hessian = random.normal(size=(2, 3)), root @ np.swapaxes(root, 1, 2)
    search.tell(state, request, ProblemAnswer(np.array([2.0, 1.0]), gradient, hessian))
    slope = (ours.parameters.at_share(u + 1e-6) - ours.parameters.at_share(u - 1e-6)) / 2e-6
    order = [int(np.argmin(np.abs(u - row).sum(axis=1))) for row in state["u"]]
    d = np.stack([np.diag(row) for row in slope])
    np.testing.assert_allclose(state["gradient"], np.einsum("pij,pj->pi", d, gradient)[order], rtol=1e-6)
    np.testing.assert_allclose(state["hessian"], (d @ hessian @ d)[order], rtol=1e-6)


def test_it_takes_no_step_that_is_not_better():
    ours = problem(design(), np.zeros((40, 4)), parameters())
    search = LeastSquares(ours, 0, 12)  # one damping for each start
    state = search.begin()
    request = search.ask(state)
    search.tell(state, request, ours.answer(request))
    before = state["u"].copy(), state["value"].copy(), state["damping"].copy()
    worse = search.ask(state)
    n = len(worse.theta)
    search.tell(state, worse, ProblemAnswer(np.full(n, 1e30), np.ones((n, 3)), np.tile(np.eye(3), (n, 1, 1))))
    np.testing.assert_array_equal(state["u"], before[0])
    np.testing.assert_array_equal(state["value"], before[1])
    np.testing.assert_allclose(state["damping"], 10 * before[2])


def test_it_finds_the_weighted_least_squares_of_measurements_and_prior():
    random = np.random.default_rng(1)
    noise = random.normal(size=(40, 4)) * np.array([0.02, 0.02, 0.02, 0.5])
    truth = NOMINAL + np.array([0.5, 4.0, -0.3])
    measured = design() @ truth + noise
    known = parameters(((1.0, 0.01), None, None), half_width=10.0)
    rows = np.concatenate([scaled(design()), [[1 / 0.01, 0, 0]]])
    wanted = np.concatenate([(measured / np.array([0.02, 0.02, 0.02, 0.5])).ravel(), [1.0 / 0.01]])
    exact = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    state = searched(problem(design(), measured, known))
    sd = np.sqrt(np.diagonal(np.linalg.inv(rows.T @ rows)))
    np.testing.assert_allclose((state["best_theta"] - exact) / sd, 0, atol=0.02)
    assert state["best_value"] <= 0.5 * np.sum((rows @ exact - wanted) ** 2) + 1e-3
    assert state["stopped"] == "converged"


@pytest.mark.parametrize(
    ("near", "gain", "goes_on"), [(False, 0.5, False), (False, 2.0, True), (True, 0.5, True), (True, 5e-4, False)]
)
def test_a_phase_ends_where_a_step_gains_less_than_it_is_worth(near, gain, goes_on):
    """A thousandth of a nat from nearby, a whole one in the search before; what the model promises is more."""
    search = LeastSquares(problem(design(), np.zeros((40, 4)), parameters()), 0, 1, near=near)
    state = search.begin()
    for value in (10.0, 10.0 - gain):
        request = search.ask(state)
        n = len(request.theta)
        search.tell(
            state, request, ProblemAnswer(np.full(n, value), np.full((n, 3), 10.0), np.tile(np.eye(3), (n, 1, 1)))
        )
    assert ((state["phase"], state["stopped"]) == (0, None)) is goes_on


def test_a_phase_ends_where_no_starts_steps_promise_anything():
    """One start at the least squares themselves, another far from them: the search goes on until that is there too."""
    truth = NOMINAL + np.array([0.2, -5.0, 0.1])
    ours = problem(design(), design() @ truth, parameters(half_width=50.0))
    search = LeastSquares(ours, 0, 2)
    state = {**search.begin(), "phase": 2}
    state["u"] = ours.parameters.share(np.stack([truth, truth + np.array([4.0, 30.0, -6.0])]))
    done = []
    while state["stopped"] is None:
        request = search.ask(state)
        search.tell(state, request, ours.answer(request))
        done.append(state["done"].copy())
    assert done[1].tolist() == [True, False]
    assert done[-1].all()
    far = ours.parameters.at_share(state["u"][1])
    assert ours.normal(far[None]).value[0] < 1e-3


def test_a_best_point_at_bounds_is_that_of_a_solver_with_bounds():
    """Two of three numbers end at their bounds, and the third where `scipy.optimize.lsq_linear` has it."""
    truth = NOMINAL + np.array([1.3, 1.0, -1.2])
    known = parameters(half_width=1.0)
    size = np.array([0.02, 0.02, 0.02, 0.5])
    measured = design() @ truth + np.random.default_rng(3).normal(size=(40, 4)) * size
    rows = scaled(design())
    exact = lsq_linear(rows, (measured / size).ravel(), (known.lower, known.upper), tol=1e-12).x
    assert (np.minimum(exact - known.lower, known.upper - exact) < 1e-5).sum() == 2
    state = searched(problem(design(), measured, known))
    np.testing.assert_allclose(state["best_theta"], exact, atol=2e-5)
    assert state["stopped"] == "converged"
    assert state["asked"] <= 12


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 8))
def test_steps_within_bounds_are_those_of_a_solver_with_bounds(seed, count):
    """`scipy.optimize.lsq_linear` (BVLS); some begin at bounds, from which the others' steps push or pull them."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(4, count + 2, count))
    matrix = np.swapaxes(root, 1, 2) @ root
    gradient = random.normal(size=(4, count)) * np.diagonal(matrix, axis1=1, axis2=2)
    lowest, highest = random.uniform(0, 0.5, size=(2, 4, count)) * np.array([-1, 1])[:, None, None]
    lowest *= random.uniform(size=lowest.shape) < 0.7
    highest *= random.uniform(size=highest.shape) < 0.7
    highest += (highest - lowest == 0) * 0.1
    step = bounded_steps(matrix, gradient, lowest, highest)
    assert ((step >= lowest) & (step <= highest)).all()
    for h, g, low, high, found in zip(matrix, gradient, lowest, highest, step, strict=True):
        factor = np.linalg.cholesky(h)
        exact = lsq_linear(factor.T, -np.linalg.solve(factor, g), (low, high), method="bvls", tol=1e-14).x
        values = [g @ x + 0.5 * x @ h @ x for x in (found, exact)]
        assert values[0] <= values[1] + 1e-7 * abs(values[1]) + 1e-12


def test_starts_that_no_short_step_can_follow_are_left_out():
    """Good with long steps, and not to be simulated with short ones: nothing has converged."""
    ours = problem(design(), design() @ NOMINAL, parameters())
    search = LeastSquares(ours, 0, 2)
    state = {**search.begin(), "phase": 2}
    request = search.ask(state)
    search.tell(state, request, ProblemAnswer(np.full(2, np.inf), np.zeros((2, 3)), np.zeros((2, 3, 3))))
    assert (state["stopped"], state["dropped"]) == ("all starts failed", 2)


def test_what_nothing_depends_on_has_no_step():
    """A number without slope or curvature, alone, with the smallest damping: no singular matrix."""
    one = Parameters(parameters().items[:1])
    search = LeastSquares(problem(design()[..., :1], np.zeros((40, 4)), one), 0, 1)
    state = {**search.begin(), "damping": np.array([1e-9])}
    state["hessian"] = state["hessian"] * 0
    _, at, _, promised = search._trials(state)
    np.testing.assert_array_equal(at, np.broadcast_to(state["u"][:, None], at.shape))
    assert promised.shape == (1, 16)


@pytest.mark.parametrize("starts", [1, 2, 5])
def test_starts_are_the_nominal_point_and_others_that_fill_the_bounds(starts):
    ours = problem(design(), np.zeros((40, 4)), parameters())
    at = LeastSquares(ours, 4, starts).scattered_starts()
    np.testing.assert_allclose(at[0], NOMINAL)
    share = (at[1:] - ours.parameters.lower) / (ours.parameters.upper - ours.parameters.lower)
    assert len(at) == starts
    strata = np.sort(np.floor(share * (starts - 1)), axis=0)  # one in each of as many slices as there are others
    np.testing.assert_array_equal(strata, np.repeat(np.arange(starts - 1)[:, None], 3, axis=1))
