"""CMA-ES and differential evolution on a bowl: seeds, bounds, failures. No knee is compiled."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fitting.methods.problem import ProblemAnswer
from fitting.methods.strategies import CmaEs, DifferentialEvolution, mirrored

pytest.importorskip("evosax")
LOWER, UPPER = np.array([1.0, -2.0]), np.array([3.0, 6.0])
NOMINAL = LOWER + np.array([0.7, 0.6]) * (UPPER - LOWER)
BOTTOM = 0.3


class Two:
    lower, upper, nominal = LOWER, UPPER, NOMINAL

    def __len__(self) -> int:
        return 2

    @staticmethod
    def share(theta: np.ndarray) -> np.ndarray:
        return (theta - LOWER) / (UPPER - LOWER)


def begun(kind: Any, seed: int, generations: int = 40) -> Any:
    problem: Any = SimpleNamespace(evaluator=SimpleNamespace(coarse=1, fine=1), parameters=Two())
    return kind(problem, seed, population=12, generations=generations)


def populations(kind: Any, seed: int, generations: int) -> tuple[list[np.ndarray], Any]:
    """What each generation asks for, and the last state."""
    search = begun(kind, seed, generations)
    state, asked = search.begin(), []
    while state["stopped"] is None:
        request = search.ask(state)
        asked.append(request.theta)
        share = (request.theta - LOWER) / (UPPER - LOWER)
        search.tell(state, request, ProblemAnswer(np.sum((share - BOTTOM) ** 2, axis=1)))
    return asked, state


@pytest.mark.parametrize("kind", [CmaEs, DifferentialEvolution])
def test_every_seed_has_its_own_course_and_every_generation_its_own_numbers(kind):
    one, again, other = (populations(kind, seed, 3)[0] for seed in (1, 1, 2))
    assert len(one) == 4
    for k in range(4):
        np.testing.assert_array_equal(one[k], again[k])
        assert not np.isclose(one[k], other[k]).all(axis=1).any()
    for a, b in pairwise(one):
        assert not np.array_equal(a, b)


def test_cma_begins_about_the_nominal_point_with_its_share_of_the_range():
    first = np.concatenate([populations(CmaEs, seed, 1)[0][0] for seed in range(30)])
    share = (first - LOWER) / (UPPER - LOWER)
    assert ((share >= 0) & (share <= 1)).all()
    draws = np.array([0.7, 0.6]) + 0.3 * np.random.default_rng(0).normal(size=(100_000, 2))
    expected = mirrored(draws)  # of a normal distribution folded at the bounds
    np.testing.assert_allclose(share.mean(axis=0), expected.mean(axis=0), atol=0.04)
    np.testing.assert_allclose(share.std(axis=0), expected.std(axis=0), atol=0.03)


@pytest.mark.parametrize("kind", [CmaEs, DifferentialEvolution])
def test_they_find_the_bottom_and_keep_the_best(kind):
    _, state = populations(kind, 0, 40)
    share = (state["best_theta"] - LOWER) / (UPPER - LOWER)
    np.testing.assert_allclose(share, BOTTOM, atol=0.02)
    assert state["best_value"] == pytest.approx(np.sum((share - BOTTOM) ** 2))
    assert (np.diff(state["bests"]) <= 0).all()


def test_mirroring_is_a_reflection_at_both_sides():
    np.testing.assert_allclose(mirrored(np.array([0.3, 1.2, -0.1, 2.3, -1.4])), [0.3, 0.8, 0.1, 0.3, 0.6])


@pytest.mark.parametrize("kind", [CmaEs, DifferentialEvolution])
def test_the_best_of_a_generation_is_stored_only_if_it_is_the_best_so_far(kind):
    search = begun(kind, 0)
    state = search.begin()
    values = np.array([7.0, 3.0, np.nan, 9.0, *[8.0] * 8])
    for best, row in ((3.0, 1), (3.0, None), (1.5, 4)):
        request = search.ask(state)
        if row is not None:
            expected = request.theta[row].copy()
        search.tell(state, request, ProblemAnswer(values))
        assert state["best_value"] == best
        np.testing.assert_array_equal(state["best_theta"], expected)
        values = values + 1 if row == 1 else np.array([7.0, 5.0, 9.0, 9.0, 1.5, *[8.0] * 7])


@pytest.mark.parametrize("kind", [CmaEs, DifferentialEvolution])
def test_members_of_the_first_population_that_failed_are_counted(kind):
    search = begun(kind, 3)
    state = search.begin()
    for failed in (5, 2):  # only those of the first
        request = search.ask(state)
        values = np.linspace(1.0, 2.0, 12)
        values[:failed] = np.nan
        search.tell(state, request, ProblemAnswer(values))
        assert state["dropped"] == 5
