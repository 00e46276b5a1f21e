"""Evolutionary searches with several populations, each with its own seed: their base classes, and `Genetic`.

All children of all populations are evaluated in one call. A fitness that is NaN or infinite ranks last, and never
becomes the best.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting.methods.problem import Method, Problem, ProblemAnswer, Request, State
from pftwin.base.arrays import Floats

Random = np.random.Generator

STALL = 50  # generations
TOLERANCE = 1e-6  # relative change per generation
SHARE = (0.4, 0.9)  # range of the factor of a difference


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
        self, problem: Problem, seed: int, population: int | None = None, generations: int | None = None
    ) -> None:
        super().__init__(problem, seed)
        p = len(problem.parameters)
        self.population = max(4, default_population(p) if population is None else population)
        self.most_iterations = 1 + (100 * p if generations is None else generations)
        self.starts = self.widest = self.population

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

    def __init__(
        self,
        problem: Problem,
        seed: int,
        *,
        populations: int = 1,
        population: int | None = None,
        generations: int | None = None,
    ) -> None:
        super().__init__(problem, seed, population, generations)
        self.populations = populations
        self.starts = self.widest = self.population * populations

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
                kept = self.surviving(state["scores"][k], own)
                state["members"][k] = np.concatenate([state["members"][k], children])[kept]
                state["scores"][k] = np.concatenate([state["scores"][k], own])[kept]
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
