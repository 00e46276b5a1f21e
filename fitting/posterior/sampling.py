"""Samples the posterior of a few parameters, to check the intervals that an estimate reports. Needs the extra
`posterior`.

A density exp(-|f|^2 / 2) of few parameters (`fitting.posterior.density`) is often thin and curved: a stiffer tendon
with more slack moves the patella almost alike. So proposals are not drawn from a distribution about the estimate but
solved for. With Q an orthonormal basis of the residuals' derivatives at the estimate, a proposal theta solves
Q'f(theta) = eta, with eta standard normal. Its density is

    |det Q' df/dtheta| exp(-|Q'f|^2 / 2),

the posterior itself for linear f, and curved like the posterior otherwise: "randomise, then optimise" (Bardsley,
Solonen, Haario and Laine 2014; arXiv:1903.00870 explains the geometry). First derivatives suffice. Proposals do not
depend on the state of a chain, so all are simulated in one batch; blackjax's independence sampler then accepts or
rejects them in sequence. An eta whose solution lies outside the bounds, or is not found, is dropped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.estimate import Estimate
from fitting.methods.problem import standard_promotion
from fitting.posterior.density import BLOCK, Density, EvaluatedPoints
from fitting.posterior.result import Posterior
from fitting.uncertainty import SERIAL
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, MissingExtraError
from pftwin.model.measured import Measured

WARMUP = 25  # draws per chain: proposals are independent, so a chain forgets its start within a few draws
_LEAST = {"draws": 8, "chains": 2, "warmup": 1}
_TOLERANCE = 1e-2  # of Q'f - eta, in standard deviations; the density used is that at the solution found
_ITERATIONS = 12  # of Newton's method
_MARGIN = 0.25  # share of the range by which iterates may leave the bounds
_SHORTER = 0.4  # factor for a step that did not improve
_FEWEST = 0.02  # least share of solutions within the bounds; with fewer, sampling stops


def sample_posterior(
    estimate: Estimate,
    *,
    draws: int = 1000,
    chains: int = 4,
    warmup: int = WARMUP,
    seed: int = 0,
    measured: Measured | Sequence[Measured] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """Samples the posterior of an estimate's parameters, with its noise and priors, uniform within its bounds.

    Args:
        estimate: estimate by likelihood, with its scene.
        draws: draws per chain; each takes some four simulations with derivatives.
        chains: number of chains, at least two, so that they can be compared.
        warmup: draws per chain that are discarded at the start.
        seed: the same seed gives the same draws.
        measured: the measurements; by default those of the estimate, or of its scene.
        progress: called with the number of proposals made and of all.

    Raises:
        MissingExtraError: blackjax is not installed.
        InputError: numbers out of range, or an estimate that `Density.of` or `proposals` refuses.
    """
    for name, value in (("draws", draws), ("chains", chains), ("warmup", warmup)):
        if not (isinstance(value, int) and value >= _LEAST[name]):
            raise InputError(f"found {value!r}", where=name, expected=f"a whole number, at least {_LEAST[name]}")
    chain_runner()  # raises for a missing package before anything is compiled
    began, count = time.perf_counter(), (draws + warmup) * chains
    density = Density.of(estimate, measured)
    report = None if progress is None else lambda done: progress(done, count)
    made = proposals(density, count, np.random.default_rng(seed), report)
    found = sampled(made.theta, made.log_density, made.log_proposal, chains=chains, warmup=warmup, seed=seed)
    r_hat, effective = _diagnosed(found.theta)
    return Posterior(
        estimate.names,
        estimate.units,
        *found,
        r_hat,
        effective,
        estimate,
        tempered=estimate.serial_correlation > SERIAL,
        evaluations=made.evaluations,
        outside=made.outside,
        unsolved=made.unsolved,
        seed=seed,
        seconds=time.perf_counter() - began,
    )


def _diagnosed(draws: Floats) -> tuple[Floats, Floats]:
    """R-hat and effective sample sizes (p,) of draws (chains, draws, p), after Vehtari et al. (2021)."""
    from blackjax import diagnostics

    @jax.jit
    def all_of(x: Array) -> tuple[Array, ...]:
        return diagnostics.rhat(x), diagnostics.ess_bulk(x), diagnostics.ess_tail(x)

    with standard_promotion():
        r_hat, bulk, tail = (np.asarray(a).reshape(-1) for a in all_of(jnp.asarray(draws, dtype=float)))
    return r_hat, np.minimum(bulk, tail)


class Proposals(NamedTuple):
    """Independent proposals with their densities."""

    theta: Floats  # (N, p)
    log_density: Floats  # (N,) of the posterior, up to a constant
    log_proposal: Floats  # (N,) of the proposal distribution, up to a constant
    outside: int  # solutions dropped because they lie beyond the bounds
    unsolved: int  # equations without a solution found
    evaluations: int


def proposals(
    density: Density, count: int, random: np.random.Generator, progress: Callable[[int], None] | None = None
) -> Proposals:
    """Makes `count` proposals; `progress` is called with their number. Raises InputError if too few solutions lie
    within the bounds."""
    start = density(density.centre[None])
    lower, upper = density.bounds
    found: list[EvaluatedPoints] = []
    have = tried = outside = evaluations = 0
    while have < count:
        eta = random.standard_normal((BLOCK, len(density.centre)))
        ended, good, spent = _solved(density, start, eta)
        inside = ((ended.theta >= lower) & (ended.theta <= upper)).all(axis=1)
        found.append(jax.tree.map(lambda a, kept=good & inside: a[kept], ended))
        have, tried = have + len(found[-1].theta), tried + len(eta)
        outside, evaluations = outside + int(np.sum(good & ~inside)), evaluations + spent
        if have < _FEWEST * tried:
            raise InputError(
                f"{tried - have} of {tried} proposals lie beyond the bounds or cannot be simulated",
                where="estimate",
                expected="parameters that the measurements fix within the bounds",
                remedy="fewer parameters, priors, or wider bounds",
            )
        if progress is not None:
            progress(min(have, count))
    points = jax.tree.map(lambda *a: np.concatenate(a)[:count], *found)
    log_proposal = np.linalg.slogdet(points.slope)[1] - 0.5 * np.sum(points.along**2, axis=1)
    return Proposals(points.theta, points.log_density, log_proposal, outside, tried - have - outside, evaluations)


def _solved(density: Density, start: EvaluatedPoints, eta: Floats) -> tuple[EvaluatedPoints, NDArray[np.bool_], int]:
    """Solves Q'f = eta (N, p) from one start: the points reached, whether they are solutions, and evaluations.

    Newton's method for all in one batch. A step is shortened if the next one, with the old slope, would not be smaller
    (Deuflhard's natural monotonicity test): residuals may grow on the way, since a thin curved density has steep sides.
    """
    lower, upper = density.bounds
    span = upper - lower
    now, size, evaluations = jax.tree.map(lambda a: np.repeat(a, len(eta), axis=0), start), np.ones(len(eta)), 1
    for _ in range(_ITERATIONS):
        off = now.along - eta
        open_ = np.flatnonzero(np.linalg.norm(off, axis=1) > _TOLERANCE)
        if not open_.size:
            break
        inverse = _inverses(now.slope[open_])
        step = _product(inverse, off[open_])
        trial = now.theta[open_] - size[open_, None] * step
        new = density(np.clip(trial, lower - _MARGIN * span, upper + _MARGIN * span))
        evaluations += len(trial)
        after = np.linalg.norm(_product(inverse, new.along - eta[open_]) / span, axis=1)
        smaller = after < (1 - size[open_] / 4) * np.linalg.norm(step / span, axis=1)
        smaller = (smaller | (np.linalg.norm(new.along - eta[open_], axis=1) <= _TOLERANCE)) & new.usable
        columns: Any = zip(now, new, strict=True)
        for kept, fresh in columns:
            kept[open_[smaller]] = fresh[smaller]
        size[open_] = np.where(smaller, np.minimum(1.0, 2 * size[open_]), _SHORTER * size[open_])
    return now, now.usable & (np.linalg.norm(now.along - eta, axis=1) <= _TOLERANCE), evaluations


def _product(matrices: Floats, vectors: Floats) -> Floats:
    return (matrices @ vectors[..., None])[..., 0]


def _inverses(slope: Floats) -> Floats:
    """Pseudo-inverses (N, p, p), since a slope may be singular; parameters are first scaled to equal size."""
    scale = np.linalg.norm(slope, axis=1)
    scale = np.where(scale > 0, scale, 1.0)
    return np.linalg.pinv(slope / scale[:, None, :]) / scale[:, :, None]


class Draws(NamedTuple):
    """Draws of all chains."""

    theta: Floats  # (chains, draws, p)
    log_density: Floats  # (chains, draws), up to a constant
    acceptance: Floats  # (chains,)


class _Point(NamedTuple):
    """A proposal with its precomputed densities."""

    theta: Any
    log_density: Any
    log_proposal: Any


def sampled(theta: Floats, log_density: Floats, log_proposal: Floats, *, chains: int, warmup: int, seed: int) -> Draws:
    """Runs chains over independent proposals (N, p), N a multiple of the chains: each starts at one, and tests its
    share of the others. The first `warmup` draws of each are discarded, including the start.
    """
    points = _Point(
        *(jnp.asarray(a.reshape(chains, -1, *a.shape[1:]), dtype=float) for a in (theta, log_density, log_proposal))
    )
    first, rest = jax.tree.map(lambda a: a[:, 0], points), jax.tree.map(lambda a: a[:, 1:], points)
    keys = jax.random.split(jax.random.key(seed), rest.log_density.shape)
    with standard_promotion():
        found, accepted = chain_runner()(keys, first, rest)
    kept, level, rate = (np.asarray(a)[:, max(warmup - 1, 0) :] for a in (found.theta, found.log_density, accepted))
    return Draws(kept, level, rate.mean(axis=1))


@cache
def chain_runner() -> Callable[[Array, _Point, _Point], tuple[_Point, Array]]:
    """Compiles a function that runs chains over proposals, from keys, starts (chains,) and proposals (chains, n).
    Raises MissingExtraError if blackjax is not installed."""
    try:
        from blackjax.mcmc import random_walk
    except ImportError as error:
        raise MissingExtraError("blackjax", extra="posterior", feature="posterior sampling") from error
    kernel = random_walk.build_irmh()

    def step(state: Any, given: tuple[Array, _Point]) -> tuple[Any, tuple[_Point, Array]]:
        key, point = given
        log_density, proposed = lambda at: at.log_density, lambda _: point
        state, about = kernel(key, state, log_density, proposed, lambda _, to: to.position.log_proposal)
        return state, (state.position, about.is_accepted)

    def chain(keys: Array, start: _Point, proposed: _Point) -> tuple[_Point, Array]:
        state = random_walk.init(start, lambda at: at.log_density)
        return jax.lax.scan(step, state, (keys, proposed))[1]

    return jax.jit(jax.vmap(chain))
