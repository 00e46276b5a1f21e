"""Steps are halved until an estimate no longer changes: by made-up errors of steps, whose effects have closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from linear_problems import NOMINAL, design, parameters, problem, run, scaled

from fitting.evaluation import Prediction
from fitting.finish import estimate_at, finished, halving_change
from fitting.methods.least_squares import LeastSquares
from fitting.methods.problem import Problem

SIGMA = np.array([0.02, 0.02, 0.02, 0.5])
DEVIATIONS = np.sqrt(np.diagonal(np.linalg.inv(scaled(design()).T @ scaled(design()))))


def with_steps(shift: float = 0.0, stretch: float = 0.0, first: int = 4, unusable: int = 10**9) -> Problem:
    """A linear model whose best parameters are off by `shift` deviations in one step a frame, in n by 1/n of that, and
    whose slopes are so much too large.

    Args:
        unusable: steps a frame from which on no motion comes out.
    """
    random = np.random.default_rng(1)
    measured = design() @ NOMINAL + SIGMA * random.normal(size=(40, 4))
    ours = problem(design(), measured, parameters(half_width=50.0))
    direction = DEVIATIONS * np.array([1.0, 0.0, 0.0])

    def with_slopes(theta: np.ndarray, substeps: int) -> Prediction:
        own = design() * (1 + stretch / substeps)
        values = own @ NOMINAL + np.einsum("tmp,np->ntm", own, theta - NOMINAL + shift / substeps * direction)
        values = values + (design() - own) @ NOMINAL
        there = np.full(len(theta), substeps < unusable)
        return Prediction(values, np.broadcast_to(own, (len(theta), *own.shape)), there)

    evaluator: Any = ours.evaluator
    evaluator.with_slopes = evaluator.values = with_slopes
    evaluator.first = evaluator.fine = evaluator.coarse = first
    return ours


@pytest.mark.parametrize(
    ("off", "same"),
    [
        ({}, True),
        ({"shift": 4 * 2 * 0.25}, True),  # moves by a quarter of a deviation: 0.03 nats
        ({"shift": 4 * 2 * 0.40}, False),  # 0.08 nats
        ({"stretch": 4 * 2 * 0.05}, True),  # slopes 10 and 5 % too large: variances of three numbers by as much twice
        ({"stretch": 4 * 2 * 0.25}, False),
        ({"shift": 100.0, "unusable": 8}, True),  # nothing to be told by
    ],
)
def test_an_estimate_is_settled_where_half_the_steps_tell_the_same(off: dict[str, Any], same: bool) -> None:
    ours = with_steps(**off)
    state = run(LeastSquares(ours, 0, 2))
    theta = np.asarray(state["best_theta"])
    assert (halving_change(lambda n: estimate_at(ours, theta, n), ours.evaluator.fine) <= 0.05) is same


def test_steps_are_halved_until_then_and_the_answer_is_that_of_short_ones() -> None:
    """Off by d / n deviations in n steps: two runs differ by d / 2n. Of d = 6 that is 0.38 at n = 8, and 0.19 at 16."""
    ours = with_steps(shift=6.0)
    search = LeastSquares(ours, 0, 2)
    before = run(search)
    search, state = finished(search, before, run)
    assert ours.evaluator.fine == 16
    exact = np.linalg.lstsq(scaled(design()), (ours.objective.measured / SIGMA).ravel(), rcond=None)[0]
    off = (np.asarray(state["best_theta"]) - exact) / DEVIATIONS
    np.testing.assert_allclose(off, [-6.0 / 16, 0.0, 0.0], atol=0.01)
    assert state["stopped"] == "converged"
    assert "notes" not in state
    assert state["iteration"] > before["iteration"]
    assert state["evaluations"] == state["history"][-1]["evaluations"]
    assert [entry["iteration"] for entry in state["history"]] == list(range(1, state["iteration"] + 1))


def test_steps_are_halved_three_times_at_most_and_it_is_reported() -> None:
    ours = with_steps(shift=1000.0)
    search = LeastSquares(ours, 0, 2)
    _, state = finished(search, run(search), run)
    assert ours.evaluator.fine == 32
    assert state["stopped"] == "converged"
    assert "steps half as long would still change" in state["notes"][0]


def test_an_interrupt_while_steps_are_tried_keeps_what_was_found() -> None:
    ours = with_steps(shift=6.0)
    search = LeastSquares(ours, 0, 2)
    before = run(search)

    def interrupted(theta: np.ndarray, substeps: int) -> Prediction:
        raise KeyboardInterrupt

    evaluator: Any = ours.evaluator
    evaluator.with_slopes = interrupted
    assert finished(search, before, run) == (search, {**before, "interrupted": True})


def test_derivatives_that_have_no_meaning_settle_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where errors grow from step to step, sums of correlated scores are no covariance."""
    import fitting.finish

    ours = with_steps()
    theta = np.asarray(run(LeastSquares(ours, 0, 2))["best_theta"])
    real = fitting.finish.uncertainty

    def negative(*args: Any) -> Any:
        found = real(*args)
        return found._replace(covariance=-found.covariance)

    monkeypatch.setattr(fitting.finish, "uncertainty", negative)
    assert halving_change(lambda n: estimate_at(ours, theta, n), ours.evaluator.fine) == np.inf


def test_methods_that_are_exact_end_where_they_were() -> None:
    ours = with_steps(shift=100.0)
    search = LeastSquares(ours, 0, 2)
    state = run(search)
    other: Any = replace(ours)
    exact = type("Exact", (LeastSquares,), {"rough": False})(other, 0, 2)
    assert finished(exact, state, run) == (exact, state)
