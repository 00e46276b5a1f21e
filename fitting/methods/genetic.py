"""A genetic algorithm after Matlab's `ga`, similar to it where that is not fully published.

As published for problems with bounds: population 50 up to 5 variables, else 200; uniform creation; rank scaling with
expectations in proportion to 1 / sqrt(rank); stochastic uniform selection; ceil(0.05 N) elite children; a fraction of
0.8 of the others by scattered crossover; at most 100 generations per variable; an end when the average relative change
of the best over 50 generations is at most 1e-6.

Ours is the mutation, in the spirit of `mutationadaptfeasible`: a step in a random direction of the box scaled to unit
sides, its length adapted to success (times 4, at most 1) and failure (a quarter, at least 1e-5) of the last generation,
and halved until it stays inside.

Several populations (seeds) live side by side, and all their children are evaluated in one call. A fitness that is NaN
or infinite ranks last, and never becomes the best.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.methods.problem import Method, Problem, ProblemAnswer, Request, State, range_of

Floats = NDArray[np.float64]
Random = np.random.Generator

CROSSOVER = 0.8
ELITE = 0.05
STALL = 50
TOLERANCE = 1e-6
_SHORTEST = 1e-5  # mutation, as a share of the range


def default_population(parameters: int) -> int:
    """Matlab's."""
    return 50 if parameters <= 5 else 200


def expectations(scores: Floats, parents: int) -> Floats:
    """How often each member (N,) should become a parent: in proportion to 1 / sqrt(rank), `parents` in all."""
    ranks = np.empty(len(scores))
    ranks[np.argsort(np.where(np.isfinite(scores), scores, np.inf), kind="stable")] = np.arange(1, len(scores) + 1)
    total = np.sum(1 / np.sqrt(np.arange(1, len(scores) + 1)))
    return parents / np.sqrt(ranks) / total


def stochastic_uniform(expected: Floats, parents: int, random: Random) -> NDArray[np.intp]:
    """Members chosen by equal steps along the line of their expectations from a random start, in random order."""
    wheel = np.cumsum(expected) / expected.sum()
    at = (random.uniform() + np.arange(parents)) / parents
    return random.permutation(np.minimum(np.searchsorted(wheel, at), len(expected) - 1))


def scattered_crossover(first: Floats, second: Floats, random: Random) -> Floats:
    """Children (M, p) that inherit each number from one parent or the other."""
    return np.where(random.uniform(size=first.shape) < 0.5, first, second)


def mutation(parents: Floats, lower: Floats, upper: Floats, length: float, random: Random) -> Floats:
    """Children (M, p) a step away in a random direction, within the bounds."""
    direction = random.standard_normal(parents.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    step = length * direction * (upper - lower)
    for _ in range(30):
        outside = ((parents + step < lower) | (parents + step > upper)).any(axis=1)
        if not outside.any():
            break
        step[outside] *= 0.5
    return np.clip(parents + step, lower, upper)


def elite_count(population: int) -> int:
    """How many members survive unchanged."""
    return math.ceil(ELITE * population)


def children_of(
    members: Floats, scores: Floats, lower: Floats, upper: Floats, length: float, random: Random
) -> tuple[NDArray[np.intp], Floats]:
    """The elite's places in the population, and the other members (N - elite, p) of the next generation."""
    n = len(members)
    elite = np.argsort(np.where(np.isfinite(scores), scores, np.inf), kind="stable")[: elite_count(n)]
    crossed = round(CROSSOVER * (n - len(elite)))
    mutated = n - len(elite) - crossed
    parents = stochastic_uniform(expectations(scores, 2 * crossed + mutated), 2 * crossed + mutated, random)
    one, two, rest = parents[:crossed], parents[crossed : 2 * crossed], parents[2 * crossed :]
    crossing = scattered_crossover(members[one], members[two], random)
    return elite, np.concatenate([crossing, mutation(members[rest], lower, upper, length, random)])


def has_stalled(best: Floats) -> bool:
    """Whether the best of the generations so far has hardly changed over the last 50."""
    if len(best) <= STALL or not np.isfinite(best[-STALL - 1 :]).all():
        return False
    last = best[-STALL - 1 :]
    return float(np.mean(np.abs(np.diff(last)) / np.maximum(np.abs(last[1:]), 1e-300))) <= TOLERANCE


class Generations(Method):
    """Base of the methods that evaluate one generation after another."""

    options = ("population", "generations")

    def __init__(
        self, problem: Problem, seed: int, population: int | None = None, generations: int | None = None
    ) -> None:
        super().__init__(problem, seed)
        p = len(problem.parameters)
        self.population = max(4, default_population(p) if population is None else population)
        self.most_iterations = 1 + (100 * p if generations is None else generations)
        self.starts = self.widest = self.population

    def settings(self) -> tuple[Any, ...]:
        """What decides its course."""
        return (self.population, self.most_iterations)

    def spread(self, state: State) -> float:
        """Of the finite scores of the last generation."""
        return range_of(state["scores"])

    def reason_to_stop(self, *, found: bool, over: bool, generations: int) -> str | None:
        """Whether nothing was found, all populations have stalled, or generations have run out."""
        if not found:
            return "all starts failed"
        if over:
            return f"the best changed by less than {TOLERANCE:g} a generation over {STALL} generations"
        return (
            f"{self.most_iterations - 1} generations, the most allowed" if generations >= self.most_iterations else None
        )


class Genetic(Generations):
    """Populations that evolve side by side, each from its own seed."""

    name = "genetic"
    options = ("population", "generations", "populations")

    def __init__(
        self,
        problem: Problem,
        seed: int,
        population: int | None = None,
        generations: int | None = None,
        populations: int = 1,
    ) -> None:
        super().__init__(problem, seed, population, generations)
        self.populations = populations
        self.starts = self.widest = self.population * populations

    def settings(self) -> tuple[Any, ...]:
        """What decides its course."""
        return (self.population, self.most_iterations, self.populations)

    def begin(self) -> State:
        """Populations all over the box."""
        p = self.problem.parameters
        members, randoms = [], []
        for k in range(self.populations):
            random = np.random.default_rng([self.seed, k])
            members.append(random.uniform(p.lower, p.upper, (self.population, len(p))))
            randoms.append(random.bit_generator.state)
        return {
            **self.blank(),
            "members": np.stack(members),
            "scores": np.full((self.populations, self.population), np.inf),
            "length": np.ones(self.populations),
            "randoms": randoms,
            "bests": [[] for _ in range(self.populations)],
            "over": [False] * self.populations,
            "children": None,
            "elite": None,
        }

    def ask(self, state: State) -> Request:
        """The first populations, then the children of those that have not ended."""
        if not state["bests"][0]:
            return Request(state["members"].reshape(-1, len(self.problem.parameters)), self.problem.evaluator.coarse)
        if state["children"] is None:
            state["elite"], state["children"] = self._bred(state)
        return Request(np.concatenate(list(state["children"])), self.problem.evaluator.coarse)

    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """The next generation."""
        value = np.where(np.isfinite(answer.value), answer.value, np.inf)
        if state["children"] is None:
            state["scores"] = value.reshape(self.populations, -1)
            state["dropped"] = int((~np.isfinite(value)).sum())
            living = list(range(self.populations))
        else:
            living = [k for k in range(self.populations) if not state["over"][k]]
            for k, own in zip(living, np.split(value, len(living)), strict=True):
                elite = state["elite"][living.index(k)]
                state["members"][k] = np.concatenate([state["members"][k][elite], state["children"][living.index(k)]])
                state["scores"][k] = np.concatenate([state["scores"][k][elite], own])
        state["children"] = state["elite"] = None
        for k in living:
            self._close_generation(state, k)
        i = np.unravel_index(np.argmin(state["scores"]), state["scores"].shape)
        if np.isfinite(state["scores"][i]):
            state["best_value"], state["best_theta"] = float(state["scores"][i]), state["members"][i].copy()
        found, generations = bool(np.isfinite(state["scores"]).any()), len(max(state["bests"], key=len))
        state["stopped"] = self.reason_to_stop(found=found, over=all(state["over"]), generations=generations)

    def _bred(self, state: State) -> tuple[list[NDArray[np.intp]], list[Floats]]:
        """Elites' places and children of the populations that have not ended."""
        p = self.problem.parameters
        elites, broods = [], []
        for k in range(self.populations):
            if state["over"][k]:
                continue
            random = np.random.default_rng()
            random.bit_generator.state = state["randoms"][k]
            elite, children = children_of(
                state["members"][k], state["scores"][k], p.lower, p.upper, float(state["length"][k]), random
            )
            state["randoms"][k] = random.bit_generator.state
            elites.append(elite)
            broods.append(children)
        return elites, broods

    def _close_generation(self, state: State, k: int) -> None:
        """The best so far, the length of mutations, and whether this population has come to its end."""
        bests = state["bests"][k]
        now = float(state["scores"][k].min())
        if bests:
            better = now < bests[-1]
            length = state["length"][k] * (4.0 if better else 0.25)
            state["length"][k] = min(1.0, max(_SHORTEST, length))
        bests.append(now)
        state["over"][k] = has_stalled(np.array(bests))
