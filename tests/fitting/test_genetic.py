"""Genetic algorithms: their operators one by one, and where they end."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fitting.methods.populations import (
    STALL,
    Genetic,
    MatlabGa,
    children_of,
    default_population,
    elite_places,
    expectations,
    has_stalled,
    mutation,
    mutation_length,
    offspring,
    scattered_crossover,
    stochastic_uniform,
)
from fitting.methods.problem import ProblemAnswer

seeds = st.integers(0, 2**32 - 1)
LOWER, UPPER = np.array([1.0, -2.0, 10.0]), np.array([2.0, -1.0, 1e3])


def population(seed: int, n: int = 20):
    random = np.random.default_rng(seed)
    return random.uniform(LOWER, UPPER, (n, 3)), random.normal(size=n), random


@settings(deadline=None)
@given(seeds, st.floats(1e-5, 1.0))
def test_mutation_keeps_the_bounds_and_moves(seed, length):
    members, _, random = population(seed)
    members[0], members[1] = LOWER, UPPER
    children = mutation(members, LOWER, UPPER, length, random)
    assert ((children >= LOWER) & (children <= UPPER)).all()
    assert (children[2:] != members[2:]).any(axis=1).all()


@settings(deadline=None)
@given(seeds)
def test_crossover_takes_every_number_from_a_parent(seed):
    members, _, random = population(seed)
    children = scattered_crossover(members[:10], members[10:], random)
    assert ((children == members[:10]) | (children == members[10:])).all()


def test_crossover_takes_half_from_each_parent_and_every_number_by_itself():
    children = scattered_crossover(np.zeros((20_000, 2)), np.ones((20_000, 2)), np.random.default_rng(0))
    counts = np.bincount((2 * children[:, 0] + children[:, 1]).astype(int), minlength=4)
    np.testing.assert_allclose(counts / 20_000, 0.25, atol=0.02)


def test_four_fifths_of_the_children_are_crossed_from_two_parents():
    """Of 50 three are the elite, 38 crossed, 9 mutated. Members are numbered in both columns: a child's two numbers
    are its parents'; a mutation as long as the range leaves no number as it was."""
    members = np.repeat(np.arange(50.0)[:, None], 2, axis=1)
    mixed = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        children = children_of(members, np.zeros(50), np.full(2, -1e4), np.full(2, 1e4), 0.9, random)
        assert len(children) == 47
        whole = (children == np.round(children)).all(axis=1)
        assert whole[:38].all()
        assert not whole[38:].any()
        mixed.append(np.mean(children[:38, 0] != children[:38, 1]))
    assert 0.4 < np.mean(mixed) < 0.55  # half of them, less those whose parents are one member twice


def test_a_mutation_is_as_long_as_its_length_in_a_box_of_unit_sides():
    middle = np.tile(0.5 * (LOWER + UPPER), (4000, 1))
    share = (mutation(middle, LOWER, UPPER, 0.3, np.random.default_rng(0)) - middle) / (UPPER - LOWER)
    np.testing.assert_allclose(np.linalg.norm(share, axis=1), 0.3, rtol=1e-9)
    np.testing.assert_allclose(share.mean(axis=0), 0, atol=0.01)
    np.testing.assert_allclose(np.cov(share.T), np.eye(3) * 0.3**2 / 3, atol=0.003)


@settings(deadline=None)
@given(seeds)
def test_the_elite_survives_and_children_keep_the_bounds(seed):
    members, scores, random = population(seed, 50)
    children, elite = children_of(members, scores, LOWER, UPPER, 1.0, random), elite_places(scores)
    assert len(elite) == 3
    assert set(elite) == set(np.argsort(scores)[:3])
    assert len(elite) + len(children) == 50
    assert ((children >= LOWER) & (children <= UPPER)).all()


@settings(deadline=None)
@given(seeds, st.randoms())
def test_expectations_go_with_the_member_not_with_its_place(seed, shuffle):
    _, scores, _ = population(seed)
    order = list(range(len(scores)))
    shuffle.shuffle(order)
    np.testing.assert_array_equal(expectations(scores[order], 30), expectations(scores, 30)[order])


def test_expectations_fall_with_the_root_of_the_rank():
    found = expectations(np.array([3.0, 1.0, 2.0, np.nan]), 7)
    np.testing.assert_allclose(found.sum(), 7)
    np.testing.assert_allclose(found / found[1], 1 / np.sqrt([3, 1, 2, 4]))


@settings(deadline=None)
@given(seeds)
def test_selection_differs_from_expectation_by_less_than_one(seed):
    _, scores, random = population(seed)
    expected = expectations(scores, 30)
    counts = np.bincount(stochastic_uniform(expected, 30, random), minlength=20)
    assert counts.sum() == 30
    assert (np.abs(counts - expected) < 1 + 1e-9).all()


def test_selection_is_random_in_order():
    expected = expectations(np.arange(20.0), 30)
    chosen = stochastic_uniform(expected, 30, np.random.default_rng(0))
    assert (np.diff(chosen) < 0).any()


@settings(deadline=None)
@given(seeds)
def test_the_same_seed_breeds_the_same_children(seed):
    one, other = (children_of(*population(seed)[:2], LOWER, UPPER, 0.5, np.random.default_rng(seed)) for _ in "ab")
    np.testing.assert_array_equal(one, other)


def test_stalling_looks_at_fifty_generations():
    assert not has_stalled(np.ones(STALL))
    assert has_stalled(np.ones(STALL + 1))
    falling = np.linspace(2, 1, STALL + 1)
    assert not has_stalled(falling)
    assert not has_stalled(np.full(STALL + 1, np.inf))


def test_matlabs_population():
    assert (default_population(4), default_population(5), default_population(6)) == (50, 50, 200)


class _Bowl:
    """A problem without a knee: a bowl with holes in which nothing can be evaluated."""

    class evaluator:  # noqa: N801
        coarse = fine = 1

    class parameters:  # noqa: N801
        lower, upper, nominal = LOWER, UPPER, 0.5 * (LOWER + UPPER)

        def __len__(self) -> int:
            return 3

    parameters = parameters()

    def answer(self, request):
        share = (request.theta - LOWER) / (UPPER - LOWER)
        value = np.sum((share - 0.3) ** 2, axis=1)
        return ProblemAnswer(np.where(share[:, 0] < 0.25, np.nan, value))


BOTH = pytest.mark.parametrize("kind", [Genetic, MatlabGa])


def evolved(kind, seed: int, populations: int = 1, generations: int = 40, problem=None):
    problem = _Bowl() if problem is None else problem
    search = kind(problem, seed, populations=populations, generations=generations)  # pyright: ignore
    state = search.begin()
    while state["stopped"] is None:
        request = search.ask(state)
        search.tell(state, request, problem.answer(request))
    return state


@BOTH
def test_nan_is_never_the_best_and_the_bowl_is_found(kind):
    state = evolved(kind, 0)
    share = (state["best_theta"] - LOWER) / (UPPER - LOWER)
    assert np.isfinite(state["best_value"])
    assert state["dropped"] > 0
    np.testing.assert_allclose(share, 0.3, atol=0.02)


@BOTH
def test_the_best_never_gets_worse(kind):
    bests = np.array(evolved(kind, 1)["bests"][0])
    assert (np.diff(bests) <= 0).all()


def test_mutations_grow_fourfold_with_success_and_shrink_to_a_quarter_with_failure():
    assert [mutation_length(b) for b in ([3.0], [3.0, 2.0], [3.0, 3.0], [3.0, 3.0, 3.0])] == [1.0, 1.0, 0.25, 1 / 16]
    assert mutation_length([3.0, 3.0, 3.0, 2.0]) == 0.25
    assert mutation_length([3.0] * 50) == 1e-5
    assert mutation_length([3.0] * 50 + [2.0]) == 4e-5


@BOTH
def test_populations_side_by_side_do_not_disturb_each_other(kind):
    alone, together = evolved(kind, 2, 1), evolved(kind, 2, 3)
    assert alone["bests"][0] == together["bests"][0]
    assert together["bests"][1] != together["bests"][0]


def test_all_failing_stops():
    problem = _Bowl()
    problem.answer = lambda request: ProblemAnswer(np.full(len(request.theta), np.nan))
    search = Genetic(problem, 0)  # pyright: ignore
    state = search.begin()
    request = search.ask(state)
    search.tell(state, request, problem.answer(request))
    assert state["stopped"] == "all starts failed"
    assert state["best_theta"] is None


@pytest.mark.parametrize("populations", [1, 4])
def test_generations_have_a_limit(populations):
    assert len(evolved(Genetic, 0, populations, 5)["bests"][0]) == 6


def test_whatever_decides_its_course_is_among_its_settings():
    options = {"population": 8, "generations": 9, "populations": 2}
    made = [
        Genetic(_Bowl(), 0, **{**options, **change}).settings()
        for change in ({}, *({k: v + 4} for k, v in options.items()))
    ]  # pyright: ignore
    assert len(set(made)) == 4


class _Valley:
    """A valley across the axes, a hundred times as long as it is wide; its bottom lies at 0.4 of every range."""

    evaluator, parameters = _Bowl.evaluator, _Bowl.parameters

    def answer(self, request):
        share = (request.theta - LOWER) / (UPPER - LOWER) - 0.4
        along = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
        return ProblemAnswer(np.linalg.norm(share @ along * [1.0, 10.0, 100.0], axis=1))


def test_children_follow_a_valley_in_which_matlabs_lose_their_way():
    """How far the best is from the bottom after some 2,000 evaluations."""
    ours, matlabs = (
        np.median([evolved(kind, seed, 1, 40, _Valley())["best_value"] for seed in range(7)])
        for kind in (Genetic, MatlabGa)
    )
    assert ours < 1e-3
    assert matlabs > 10 * ours


def test_a_child_is_a_parent_and_a_share_of_a_difference():
    """Of four members the best is a parent in 7 of 16 tournaments of two, the worst in one."""
    random = np.random.default_rng(3)
    members, scores = random.normal(size=(4, 5)), np.array([2.0, np.inf, 1.0, 3.0])
    far, parents = np.full(5, 100.0), np.zeros(4)
    differences = np.array([members[j] - members[k] for j in range(4) for k in range(4) if j != k])
    for _ in range(500):
        for child in offspring(members, scores, -far, far, random):
            step = child - members  # from every member that may be its parent
            shares = step @ differences.T / np.sum(differences**2, axis=1)
            off = np.linalg.norm(step[:, None] - shares[..., None] * differences, axis=-1)
            good = (off < 1e-9) & (shares >= 0.4) & (shares <= 0.9)
            parent = good.any(axis=1) | (np.linalg.norm(step, axis=1) == 0)
            assert parent.any()
            parents += parent / parent.sum()
    np.testing.assert_allclose(parents / parents.sum(), np.array([5, 1, 7, 3]) / 16, atol=0.04)


@settings(deadline=None)
@given(seeds)
def test_children_keep_the_bounds(seed):
    members, scores, random = population(seed, 30)
    children = offspring(members, scores, LOWER, UPPER, random)
    assert children.shape == members.shape
    assert ((children >= LOWER) & (children <= UPPER)).all()
