"""A genetic algorithm whose children follow the shape of their population.

Every child is a parent, chosen by a tournament of two (Goldberg & Deb 1991), plus a random share of the difference of
two other members (Storn & Price 1997). Differences are long along a valley of the objective and short across it,
however parameters are correlated, and shrink as the population gathers. The best of parents and children survive.
Matlab's operators, which act on one parameter at a time, lose their way in such valleys: `fitting.methods.matlab_ga`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitting.methods.populations import Floats, Populations, Random
from fitting.methods.problem import State

SHARE = (0.4, 0.9)  # of a difference that a child takes


def children_of(members: Floats, scores: Floats, lower: Floats, upper: Floats, random: Random) -> Floats:
    """As many children (N, p) as members (N, p), within the bounds."""
    n = len(members)
    one, two = random.integers(n, size=(2, n))
    parent = np.where(scores[one] < scores[two], one, two)
    other, third = random.integers(n, size=(2, n))
    share = random.uniform(*SHARE, size=(n, 1))
    return np.clip(members[parent] + share * (members[other] - members[third]), lower, upper)


class Genetic(Populations):
    """Populations that breed by differences."""

    name = "genetic"

    def bred(self, state: State, k: int, random: Random) -> Floats:
        """As many children as members."""
        p = self.problem.parameters
        return children_of(state["members"][k], state["scores"][k], p.lower, p.upper, random)

    def surviving(self, scores: Floats, own: Floats) -> NDArray[np.intp]:
        """The best of parents and children."""
        return np.argsort(np.concatenate([scores, own]), kind="stable")[: len(scores)]
