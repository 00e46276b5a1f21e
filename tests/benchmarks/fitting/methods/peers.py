"""Other people's optimisers with their own defaults, on the same problem: scipy's and pycma.

What they are told besides the bounds: dual annealing and pycma begin at the guess that every method is given, and pycma
with a spread of 0.3 of the range, like evosax's. Nothing is polished.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pftwin.base.errors import MissingExtraError
from tests.benchmarks.fitting.methods.meter import Meter

SCIPY_POPULATION = 15  # members per parameter: scipy's default
_SPREAD = 0.3  # of pycma's first generation, as a share of the range


def scipy_differential_evolution(meter: Meter, seed: int) -> str:
    """`differential_evolution` with `vectorized=True`, so that it gets its generations as batches."""
    from scipy.optimize import Bounds, differential_evolution

    p = meter.problem.parameters

    def population(x: Any) -> Any:  # (p, members)
        return meter.values(x.T)

    found = differential_evolution(
        population,
        Bounds(p.lower, p.upper),
        popsize=SCIPY_POPULATION,
        maxiter=10**6,
        rng=np.random.default_rng(seed),
        polish=False,
        vectorized=True,
        updating="deferred",  # what vectorized implies
    )
    return str(found.message)


def scipy_dual_annealing(meter: Meter, seed: int) -> str:
    """`dual_annealing`: it asks for one point at a time, its own local searches included."""
    from scipy.optimize import Bounds, dual_annealing

    p = meter.problem.parameters
    found = dual_annealing(
        lambda x: float(meter.values(x[None])[0]),
        Bounds(p.lower, p.upper),
        maxiter=10**6,
        maxfun=10**7,
        x0=p.nominal,
        rng=np.random.default_rng(seed),
    )
    return str(found.message)


def pycma(meter: Meter, seed: int) -> str:
    """pycma's CMA-ES with its default population; generations are batches."""
    strategy = _strategy(meter, seed)
    p = meter.problem.parameters
    while not strategy.stop():
        shares = strategy.ask()
        values = meter.values(p.lower + (p.upper - p.lower) * np.stack(shares))
        strategy.tell(shares, values.tolist())
    return ", ".join(strategy.stop())


def pycma_population(parameters: int) -> int:
    """Its default: 4 + 3 log(p)."""
    return 4 + int(3 * np.log(parameters))


def _strategy(meter: Meter, seed: int) -> Any:
    try:
        import cma
    except ImportError as error:
        raise MissingExtraError("cma", extra="benchmarks", feature="the comparison with pycma") from error
    p = meter.problem.parameters
    start = (p.nominal - p.lower) / (p.upper - p.lower)
    # pycma takes seed 0 for the time of day.
    options = {"bounds": [0.0, 1.0], "seed": seed + 1, "verbose": -9, "popsize": pycma_population(len(p))}
    return cma.CMAEvolutionStrategy(start, _SPREAD, options)
