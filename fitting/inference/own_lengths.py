"""Straight lines nearest to springs over the lengths at which the fitted knee's tendons work.

Springs that stiffen are learned from as lines over the lengths at which the nominal knee's tendons work, which are the
same for all simulations. What a laboratory finds with a load cell is the line over what occurred. Draws are told by it:
their springs stay what they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.stiffening import working_of
from pftwin.base.arrays import Floats
from pftwin.base.errors import PftwinError

_OF_SPRINGS = ("stiffness", "slack_length", "stiffening")


def at_own_lengths(problem: Problem, besides: Nuisance, draws: Floats) -> tuple[Nuisance, Floats]:
    """Draws (N, p), and nuisance, with the lengths at which tendons work in the motions of the draws' mean.

    Tendons of which stiffness, slack length and stiffening are not all free are left as they are, those of which one
    differs between trials, and those that would hang slack in some draw; so are all where that motion cannot be
    simulated, which is told where the fit is judged.
    """
    parameters = problem.parameters
    vary = {parameters.items[at].place for at, _ in parameters.differences}
    columns = {p.place.name: i for i, p in enumerate(parameters.items) if p.place not in vary}
    numbers = {name: [f"{name}.{number}" for number in _OF_SPRINGS] for name, _ in besides.working}
    places = {name: [columns[n] for n in own] for name, own in numbers.items() if columns.keys() >= set(own)}
    if not places:
        return besides, draws
    try:
        found = working_of(problem.evaluator.scenes_at(draws.mean(axis=0)), tuple(places))
    except PftwinError:  # a mean beyond the scene's limits
        return besides, draws
    known, told = dict(besides.working), draws.copy()
    for name, own in places.items():
        there = np.stack(known[name].told_at(found[name], *draws[:, own].T), axis=1)
        if np.isfinite(there).all() and (there[:, :2] > 0).all() and found[name].taut(there[:, 1].max()):
            told[:, own], known[name] = there, found[name]
    return replace(besides, working=tuple(known.items())), told
