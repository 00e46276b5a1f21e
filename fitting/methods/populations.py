"""Evolutionary searches with several populations, each with its own seed: their base classes, `Genetic`, `MatlabGa`.

All children of all populations are evaluated in one call. A fitness that is NaN or infinite ranks last, and never
becomes the best.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.methods.problem import Method, Problem, ProblemAnswer, Request, State
from pftwin.base.arrays import Floats

Random = np.random.Generator

STALL = 50  # generations
TOLERANCE = 1e-6  # relative change per generation
SHARE = (0.4, 0.9)  # range of the factor of a difference
CROSSOVER, ELITE = 0.8, 0.05  # of Matlab's algorithm: share of children by crossover, of members that survive
_SHORTEST = 1e-5  # shortest mutation, as a share of the range


def default_population(parameters: int) -> int:
    """Matlab's default population size."""
    return 50 if parameters <= 5 else 200


def has_stalled(best: Floats) -> bool:
    """Whether the best value of each generation has hardly changed over the last 50."""
    if len(best) <= STALL or not np.isfinite(best[-STALL - 1 :]).all():
        return False
    last = best[-STALL - 1 :]
    return float(np.mean(np.abs(np.diff(last)) / np.maximum(np.abs(last[1:]), 1e-300))) <= TOLERANCE


class Generations(Method):
    """Base of the methods that evaluate one generation after another."""

    options = ("population", "generations")
    values = "scores"

    def __init__(
        self,
        problem: Problem,
        seed: int,
        population: int | None = None,
        generations: int | None = None,
        populations: int = 1,
    ) -> None:
        super().__init__(problem, seed)
        p = len(problem.parameters)
        self.population = max(4, default_population(p) if population is None else population)
        self.populations = populations
        self.most_iterations = 1 + (100 * p if generations is None else generations)
        self.starts = self.widest = self.population * populations

    def reason_to_stop(self, *, found: bool, over: bool, generations: int) -> str | None:
        """Why to stop: nothing was found, all populations have stalled, or generations have run out; otherwise None."""
        if not found:
            return "all starts failed"
        if over:
            return f"the best changed by less than {TOLERANCE:g} a generation over {STALL} generations"
        most = self.most_iterations
        return f"{most - 1} generations, the most allowed" if generations >= most else None


class Populations(Generations):
    """Base of the methods whose populations breed."""

    options = ("population", "generations", "populations")

    def settings(self) -> tuple[Any, ...]:
        """Settings that, with problem and seed, determine its iterates."""
        return (*super().settings(), self.populations)

    @abstractmethod
    def bred(self, state: State, k: int, random: Random) -> Floats:
        """Children (M, p) of population k, within the bounds."""

    @abstractmethod
    def surviving(self, scores: Floats, own: Floats) -> NDArray[np.intp]:
        """Indices of the N survivors among members (N,) and their children (M,), in this order, given both scores."""

    def begin(self) -> State:
        """Populations spread uniformly within the bounds."""
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
            "randoms": randoms,
            "bests": [[] for _ in range(self.populations)],
            "over": [False] * self.populations,
            "children": None,
        }

    def ask(self, state: State) -> Request:
        """The first populations, then the children of those that have not stalled."""
        if not state["bests"][0]:
            return Request(state["members"].reshape(-1, len(self.problem.parameters)), self.problem.evaluator.coarse)
        if state["children"] is None:
            state["children"] = []
            for k in self._living(state):
                random = np.random.default_rng()
                random.bit_generator.state = state["randoms"][k]
                state["children"].append(self.bred(state, k, random))
                state["randoms"][k] = random.bit_generator.state
        return Request(np.concatenate(list(state["children"])), self.problem.evaluator.coarse)

    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Selects the next generation."""
        value = np.where(np.isfinite(answer.value), answer.value, np.inf)
        living = self._living(state)
        if state["children"] is None:
            state["scores"] = value.reshape(self.populations, -1)
            state["dropped"] = int((~np.isfinite(value)).sum())
        else:
            for k, children, own in zip(living, state["children"], np.split(value, len(living)), strict=True):
                survivors = self.surviving(state["scores"][k], own)
                state["members"][k] = np.concatenate([state["members"][k], children])[survivors]
                state["scores"][k] = np.concatenate([state["scores"][k], own])[survivors]
        state["children"] = None
        for k in living:
            state["bests"][k].append(float(state["scores"][k].min()))
            state["over"][k] = has_stalled(np.array(state["bests"][k]))
        i = np.unravel_index(np.argmin(state["scores"]), state["scores"].shape)
        if np.isfinite(state["scores"][i]):
            state["best_value"], state["best_theta"] = float(state["scores"][i]), state["members"][i].copy()
        found, generations = bool(np.isfinite(state["scores"]).any()), len(max(state["bests"], key=len))
        state["stopped"] = self.reason_to_stop(found=found, over=all(state["over"]), generations=generations)

    def _living(self, state: State) -> list[int]:
        return [k for k in range(self.populations) if not state["over"][k]]


def offspring(members: Floats, scores: Floats, lower: Floats, upper: Floats, random: Random) -> Floats:
    """As many children (N, p) as members (N, p), within the bounds."""
    n = len(members)
    one, two = random.integers(n, size=(2, n))
    parent = np.where(scores[one] < scores[two], one, two)
    other, third = random.integers(n, size=(2, n))
    share = random.uniform(*SHARE, size=(n, 1))
    return np.clip(members[parent] + share * (members[other] - members[third]), lower, upper)


class Genetic(Populations):
    """Differential evolution with tournament selection.

    Every child is a parent, chosen by a tournament of two (Goldberg & Deb 1991), plus a random share of the difference
    of two other members (Storn & Price 1997). Differences are long along a valley of the objective and short across it,
    however parameters are correlated, and shrink as the population converges. The best of parents and children survive.
    Matlab's operators act on one parameter at a time, and do badly in such valleys.
    """

    name = "genetic"

    def bred(self, state: State, k: int, random: Random) -> Floats:
        """As many children as members."""
        p = self.problem.parameters
        return offspring(state["members"][k], state["scores"][k], p.lower, p.upper, random)

    def surviving(self, scores: Floats, own: Floats) -> NDArray[np.intp]:
        """The best of parents and children."""
        return np.argsort(np.concatenate([scores, own]), kind="stable")[: len(scores)]


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
    """Children (M, p) that inherit each parameter from one parent or the other."""
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


def elite_places(scores: Floats) -> NDArray[np.intp]:
    """Indices of the ceil(0.05 N) members (N,) that survive unchanged, the best first."""
    order = np.argsort(np.where(np.isfinite(scores), scores, np.inf), kind="stable")
    return order[: math.ceil(ELITE * len(scores))]


def children_of(members: Floats, scores: Floats, lower: Floats, upper: Floats, length: float, random: Random) -> Floats:
    """All other members (N - elite, p) of the next generation."""
    born = len(members) - len(elite_places(scores))
    crossed = round(CROSSOVER * born)
    mutated = born - crossed
    parents = stochastic_uniform(expectations(scores, 2 * crossed + mutated), 2 * crossed + mutated, random)
    one, two, rest = parents[:crossed], parents[crossed : 2 * crossed], parents[2 * crossed :]
    crossing = scattered_crossover(members[one], members[two], random)
    return np.concatenate([crossing, mutation(members[rest], lower, upper, length, random)])


def mutation_length(bests: list[float]) -> float:
    """Length of the next mutations, as a share of the range, from the best value of every generation so far."""
    length = 1.0
    for before, now in pairwise(bests):
        length = min(1.0, max(_SHORTEST, length * (4.0 if now < before else 0.25)))
    return length


class MatlabGa(Populations):
    """A genetic algorithm after Matlab's `ga`, similar to it where that is not fully published.

    As published for problems with bounds: population 50 up to 5 variables, else 200; uniform creation; rank scaling
    with expectations in proportion to 1 / sqrt(rank); stochastic uniform selection; ceil(0.05 N) elite children; a
    fraction of 0.8 of the others by scattered crossover; at most 100 generations per variable; an end when the average
    relative change of the best over 50 generations is at most 1e-6.

    The mutation is our own, in the spirit of `mutationadaptfeasible`: a step in a random direction of the box scaled to
    unit sides, its length adapted to success (times 4, at most 1) and failure (a quarter, at least 1e-5) of the last
    generation, and halved until it stays inside.
    """

    name = "matlab_ga"

    def bred(self, state: State, k: int, random: Random) -> Floats:
        """Children by crossover and mutation."""
        p = self.problem.parameters
        length = mutation_length(state["bests"][k])
        return children_of(state["members"][k], state["scores"][k], p.lower, p.upper, length, random)

    def surviving(self, scores: Floats, own: Floats) -> NDArray[np.intp]:
        """The elite, and all children."""
        return np.concatenate([elite_places(scores), len(scores) + np.arange(len(own))])
