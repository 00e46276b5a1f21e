"""Metropolis and Hastings' independence sampler over proposals that were made beforehand.

Proposals do not depend on where a chain is, so all of them are simulated side by side; blackjax's kernel then accepts
or rejects them one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.methods.method import lenient
from pftwin.base.errors import MissingExtraError

Floats = NDArray[np.float64]


class Draws(NamedTuple):
    """What was sampled."""

    theta: Floats  # (chains, draws, p)
    log_density: Floats  # (chains, draws), up to a constant
    acceptance: Floats  # (chains,)


class _Point(NamedTuple):
    """A proposal, with what was computed of it beforehand."""

    theta: Any
    log_density: Any
    log_proposal: Any


def sampled(theta: Floats, log_density: Floats, log_proposal: Floats, *, chains: int, warmup: int, seed: int) -> Draws:
    """Chains over independent proposals: each begins at one, and meets its share of the others.

    Args:
        theta: proposals (N, p), N a multiple of the chains.
        log_density: of the density wanted, up to a constant (N,).
        log_proposal: of the proposals' own density, up to a constant (N,).
        chains: how many.
        warmup: draws of each chain that are thrown away, the start among them.
        seed: of acceptance.

    Raises:
        MissingExtraError: blackjax is not installed.
    """
    run = accepting()

    def shaped(a: Floats) -> Array:
        return jnp.asarray(a.reshape(chains, -1, *a.shape[1:]), dtype=float)

    points = _Point(*(shaped(a) for a in (theta, log_density, log_proposal)))
    first, rest = jax.tree.map(lambda a: a[:, 0], points), jax.tree.map(lambda a: a[:, 1:], points)
    keys = jax.random.split(jax.random.key(seed), rest.log_density.shape)
    with lenient():
        found, accepted = run(keys, first, rest)
    kept, level, rate = (np.asarray(a)[:, max(warmup - 1, 0) :] for a in (found.theta, found.log_density, accepted))
    return Draws(kept, level, rate.mean(axis=1))


@cache
def accepting() -> Callable[[Array, _Point, _Point], tuple[_Point, Array]]:
    """A compiled function that runs chains over proposals: from keys, starts (chains,) and proposals (chains, n).

    Raises:
        MissingExtraError: blackjax is not installed.
    """
    try:
        from blackjax.mcmc import random_walk
    except ImportError as error:
        raise MissingExtraError("blackjax", extra="posterior", feature="posterior sampling") from error
    kernel = random_walk.build_irmh()

    def step(state: Any, given: tuple[Array, _Point]) -> tuple[Any, tuple[_Point, Array]]:
        key, point = given
        state, about = kernel(
            key,
            state,
            lambda at: at.log_density,
            lambda _: point,
            lambda _, to: to.position.log_proposal,
        )
        return state, (state.position, about.is_accepted)

    def chain(keys: Array, start: _Point, proposed: _Point) -> tuple[_Point, Array]:
        state = random_walk.init(start, lambda at: at.log_density)
        return jax.lax.scan(step, state, (keys, proposed))[1]

    return jax.jit(jax.vmap(chain))
