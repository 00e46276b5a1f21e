"""A genetic algorithm after Matlab's `ga`, similar to it where that is not fully published.

As published for problems with bounds: population 50 up to 5 variables, else 200; uniform creation; rank scaling with
expectations in proportion to 1 / sqrt(rank); stochastic uniform selection; ceil(0.05 N) elite children; a fraction of
0.8 of the others by scattered crossover; at most 100 generations per variable; an end when the average relative change
of the best over 50 generations is at most 1e-6.

The mutation is our own, in the spirit of `mutationadaptfeasible`: a step in a random direction of the box scaled to
unit sides, its length adapted to success (times 4, at most 1) and failure (a quarter, at least 1e-5) of the last
generation, and halved until it stays inside.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fitting.methods.populations import Floats, Populations, Random
from fitting.methods.problem import State

CROSSOVER = 0.8
ELITE = 0.05
_SHORTEST = 1e-5  # shortest mutation, as a share of the range


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
    """Populations that breed as in Matlab."""

    name = "matlab_ga"

    def bred(self, state: State, k: int, random: Random) -> Floats:
        """Children by crossover and mutation."""
        p = self.problem.parameters
        length = mutation_length(state["bests"][k])
        return children_of(state["members"][k], state["scores"][k], p.lower, p.upper, length, random)

    def surviving(self, scores: Floats, own: Floats) -> NDArray[np.intp]:
        """The elite, and all children."""
        return np.concatenate([elite_places(scores), len(scores) + np.arange(len(own))])
