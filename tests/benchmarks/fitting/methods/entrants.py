"""Who takes part in the comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from fitting.methods.problem import Problem
from tests.benchmarks.fitting.methods import mapped_starts, ours, peers
from tests.benchmarks.fitting.methods.meter import Meter


class Entrant(NamedTuple):
    """A method, what it is called, and the batches in which it asks for plain values."""

    name: str
    label: str
    own: bool  # one of `fitting.fit_tendons`
    run: Callable[[Meter, int], str]  # with a seed; returns why it stopped
    widest: Callable[[Problem], int | None]


_LABELS = {
    "least_squares": "least squares (default)",
    "gradient": "gradient (Adam, L-BFGS)",
    "genetic": "genetic",
    "matlab_ga": "genetic, after Matlab's ga",
    "cma_es": "CMA-ES (evosax)",
    "differential_evolution": "differential evolution (evosax)",
}


def _own(name: str) -> Entrant:
    def run(meter: Meter, seed: int) -> str:
        return ours.run(name, meter, seed)

    return Entrant(name, _LABELS[name], True, run, lambda problem: ours.widest(name, problem))


ENTRANTS = (
    *(_own(name) for name in ours.OURS),
    Entrant(
        "optimistix",
        "Levenberg-Marquardt, mapped starts (optimistix)",
        False,
        mapped_starts.optimistix_levenberg_marquardt,
        lambda problem: None,
    ),
    Entrant(
        "scipy_differential_evolution",
        "differential evolution, vectorized (scipy)",
        False,
        peers.scipy_differential_evolution,
        lambda problem: peers.SCIPY_POPULATION * len(problem.parameters),
    ),
    Entrant(
        "scipy_dual_annealing",
        "dual annealing, one point at a time (scipy)",
        False,
        peers.scipy_dual_annealing,
        lambda problem: 1,
    ),
    Entrant(
        "pycma",
        "CMA-ES (pycma)",
        False,
        peers.pycma,
        lambda problem: peers.pycma_population(len(problem.parameters)),
    ),
)
