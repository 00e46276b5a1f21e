"""Straight lines nearest to springs over the lengths at which the fitted knee's tendons work.

Springs that stiffen are learned from as lines over the lengths at which the nominal knee's tendons work, which are the
same for all simulations. What a laboratory finds with a load cell is the line over what occurred. Draws are told by it:
their springs stay what they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.stiffening import working_of

Floats = NDArray[np.float64]

_OF_SPRINGS = ("stiffness", "slack_length", "stiffening")


def at_own_lengths(problem: Problem, besides: Nuisance, draws: Floats) -> tuple[Nuisance, Floats]:
    """Draws (N, p), and nuisance, with the lengths at which tendons work in the motions of the draws' mean.

    Tendons of which stiffness, slack length and stiffening are not all free are left as they are; so are all where that
    motion is not finite.
    """
    columns = {p.place.name: i for i, p in enumerate(problem.parameters.items)}
    numbers = {name: [f"{name}.{number}" for number in _OF_SPRINGS] for name, _ in besides.working}
    places = {name: [columns[n] for n in own] for name, own in numbers.items() if columns.keys() >= set(own)}
    if not places:
        return besides, draws
    mean, nominal = draws.mean(axis=0), problem.parameters.nominal
    fitted = [e.parameters.apply(e.scene, mean + e.parameters.nominal - nominal) for e in problem.evaluator.own]
    found, old = working_of(fitted, tuple(places)), dict(besides.working)
    if not np.isfinite([*found.values()]).all():
        return besides, draws
    told = draws.copy()
    for name, own in places.items():
        told[:, own] = np.stack(old[name].told_at(found[name], *draws[:, own].T), axis=1)
    return replace(besides, working=tuple((old | found).items())), told
