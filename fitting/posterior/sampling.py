"""Sampling the posterior of few parameters: a check of the intervals that an estimate reports.

    posterior = fitting.sample_posterior(estimate)
    print(posterior.sentence())

Which density is sampled says `fitting.posterior.density`; how, `fitting.posterior.randomised` and
`fitting.posterior.independence`. Needs the extra `posterior` (blackjax).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fitting.estimate import Estimate
from fitting.methods.method import lenient
from fitting.posterior.density import Density
from fitting.posterior.independence import accepting, sampled
from fitting.posterior.randomised import proposals
from fitting.posterior.result import Posterior
from fitting.uncertainty import SERIAL
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

Floats = NDArray[np.float64]

WARMUP = 25  # draws of each chain: proposals are independent, so chains forget their start within some
_FEWEST = {"draws": 8, "chains": 2, "warmup": 1}


def sample_posterior(
    estimate: Estimate,
    *,
    draws: int = 1000,
    chains: int = 4,
    warmup: int = WARMUP,
    seed: int = 0,
    measured: Measured | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """The posterior of an estimate's parameters, with its noise and priors, uniform within its bounds.

    Args:
        estimate: of a likelihood, with its scene.
        draws: of each chain; each costs some four simulations with derivatives.
        chains: at least two, so that they can be compared.
        warmup: draws of each chain before them, which are thrown away.
        seed: the same seed gives the same draws.
        measured: the measurements; by default those of the estimate, or of its scene.
        progress: called with the number of proposals made and of all.

    Raises:
        MissingExtraError: blackjax is not installed.
        InputError: numbers out of range, or what `Density.of` and `proposals` have against the estimate.
    """
    for name, value in (("draws", draws), ("chains", chains), ("warmup", warmup)):
        if not (isinstance(value, int) and value >= _FEWEST[name]):
            raise InputError(f"found {value!r}", where=name, expected=f"a whole number, at least {_FEWEST[name]}")
    accepting()  # says what is missing before anything is compiled
    began, count = time.perf_counter(), (draws + warmup) * chains
    density = Density.of(estimate, measured)
    report = None if progress is None else lambda done: progress(done, count)
    made = proposals(density, count, np.random.default_rng(seed), report)
    found = sampled(made.theta, made.log_density, made.log_proposal, chains=chains, warmup=warmup, seed=seed)
    r_hat, effective = _diagnosed(found.theta)
    return Posterior(
        estimate.names,
        estimate.units,
        found.theta,
        found.log_density,
        found.acceptance,
        r_hat,
        effective,
        estimate,
        estimate.serial_correlation > SERIAL,
        made.evaluations,
        made.outside,
        made.unsolved,
        seed,
        time.perf_counter() - began,
    )


def _diagnosed(draws: Floats) -> tuple[Floats, Floats]:
    """R-hat and effective sample sizes (p,) of draws (chains, draws, p), after Vehtari et al. (2021)."""
    import jax
    import jax.numpy as jnp
    from blackjax import diagnostics

    @jax.jit
    def all_of(x: jax.Array) -> tuple[jax.Array, ...]:
        return diagnostics.rhat(x), diagnostics.ess_bulk(x), diagnostics.ess_tail(x)

    with lenient():
        r_hat, bulk, tail = (np.asarray(a) for a in all_of(jnp.asarray(draws, dtype=float)))
    p = draws.shape[-1]
    return r_hat.reshape(p), np.minimum(bulk, tail).reshape(p)


__all__ = ["Posterior", "sample_posterior"]
