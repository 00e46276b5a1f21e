"""The methods of `fitting.fit_tendons`, each with its own defaults, run through the meter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fitting.finish import with_nominal
from fitting.methods.gradient import Gradient
from fitting.methods.least_squares import LeastSquares
from fitting.methods.populations import Genetic, MatlabGa
from fitting.methods.problem import Method, Problem, State
from fitting.methods.strategies import CmaEs, DifferentialEvolution
from tests.benchmarks.fitting.methods.meter import Meter

OURS: dict[str, Callable[..., Method]] = {
    "least_squares": LeastSquares,
    "gradient": Gradient,
    "genetic": Genetic,
    "matlab_ga": MatlabGa,
    "cma_es": CmaEs,
    "differential_evolution": DifferentialEvolution,
}


def widest(name: str, problem: Problem) -> int | None:
    """The largest batch of plain values that a method asks for; None: it asks for derivatives only."""
    return OURS[name](problem, 0).widest


def run(name: str, meter: Meter, seed: int) -> str:
    """Runs a method to its end, as `fit_tendons` does; returns why it stopped.

    Raises:
        SpentError: the budget was spent first.
    """
    search = OURS[name](meter.problem, seed)
    state = _ended(search, meter)
    if search.rough and state["best_theta"] is not None:
        from_there = with_nominal(meter.problem, np.asarray(state["best_theta"]))
        state = _ended(LeastSquares(from_there, seed, near=True), meter)
    return str(state["stopped"])


def _ended(search: Method, meter: Meter) -> State:
    state: dict[str, Any] = search.begin()
    while state["stopped"] is None:
        request = search.ask(state)
        search.tell(state, request, meter.answer(request))
    return state
