"""Network that maps a recording's summaries to a distribution of parameters: a mixture of normal distributions.

For each summary vector it gives weights, means and covariances (as Cholesky factors of precisions). It is trained to
maximise the likelihood of the parameters of simulated recordings, and so converges to the posterior under the prior
from which they were drawn, without an explicit likelihood. Source: Papamakarios & Murray 2016 (NeurIPS 29), without
their correction for proposals: here these are the truncated prior (Deistler, Goncalves & Macke 2022, NeurIPS 35).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.inference.recordings import SummaryNoise
from fitting.methods.problem import standard_promotion
from pftwin.base.arrays import Floats

_COMPONENTS, _WIDTH, _DEPTH = 4, 128, 3
_EPOCHS, _PATIENCE = 100, 12  # most epochs; epochs without progress on held-out recordings after which training ends
_BATCH, _RATE, _DECAY = 256, 1e-3, 1e-3
_ASIDE, _NOISES_ASIDE = 0.1, 4  # share of held-out recordings, and how often each is used, with different noise
_LARGEST_LOG = 8.0  # of a precision's root: parameters and summaries have unit variance


class Mixture(NamedTuple):
    """A mixture of k normal distributions of p parameters."""

    log_weights: Array  # (k,)
    means: Array  # (k, p)
    roots: Array  # (k, p, p) lower triangular L, precisions are L L'


class PosteriorNetwork(eqx.Module):
    """Maps summaries (s,) to a mixture over parameters (p,), both of zero mean and unit variance."""

    bent: eqx.nn.MLP
    straight: eqx.nn.Linear  # means are mostly linear in summaries
    parameters: int = eqx.field(static=True)

    def __init__(self, summaries: int, parameters: int, seed: int) -> None:
        one, other = jax.random.split(jax.random.key(seed))
        outputs = _COMPONENTS * (1 + parameters + parameters * (parameters + 1) // 2)
        kind: Any = {"dtype": jnp.float32}
        self.bent = eqx.nn.MLP(summaries, outputs, _WIDTH, _DEPTH, activation=jax.nn.silu, key=one, **kind)
        self.straight = eqx.nn.Linear(summaries, parameters, key=other, **kind)
        self.parameters = parameters

    def __call__(self, summaries: Array) -> Mixture:
        """The posterior of one recording."""
        k, p = _COMPONENTS, self.parameters
        weights, means, entries = jnp.split(self.bent(summaries), [k, k + k * p])
        rows, columns = np.tril_indices(p)
        roots = jnp.zeros((k, p, p), entries.dtype).at[:, rows, columns].set(entries.reshape(k, -1))
        logs = jnp.clip(jnp.diagonal(roots, axis1=1, axis2=2), -_LARGEST_LOG, _LARGEST_LOG)
        roots = jnp.where(np.eye(p, dtype=bool), jnp.exp(logs)[:, None, :], roots)
        return Mixture(jax.nn.log_softmax(weights), means.reshape(k, p) + self.straight(summaries), roots)

    def log_density(self, summaries: Array, parameters: Array) -> Array:
        """Log density of parameters (p,), up to a constant."""
        at = self(summaries)
        off = jnp.einsum("kij,ki->kj", at.roots, parameters - at.means)
        volume = jnp.sum(jnp.log(jnp.diagonal(at.roots, axis1=1, axis2=2)), axis=1)
        return jax.scipy.special.logsumexp(at.log_weights + volume - 0.5 * jnp.sum(off**2, axis=1))

    def draws(self, summaries: Floats, count: int, random: np.random.Generator) -> Floats:
        """Parameters (N, count, p) from the posteriors of recordings with these summaries (N, s)."""
        with standard_promotion():
            at = jax.tree.map(np.asarray, _mixtures(self, jnp.asarray(summaries, jnp.float32)))
        rows = np.arange(len(summaries))[:, None]
        cumulative = np.cumsum(np.exp(at.log_weights.astype(float)), axis=1)
        drawn = random.uniform(size=(len(rows), count, 1)) * cumulative[:, None, -1:]
        which = np.sum(drawn > cumulative[:, None, :-1], axis=2)
        back = np.swapaxes(np.linalg.inv(at.roots.astype(float)), 2, 3)[rows, which]
        normal = random.standard_normal((len(rows), count, self.parameters))
        return at.means[rows, which] + np.einsum("ncij,ncj->nci", back, normal)


def leaves_of(net: PosteriorNetwork) -> list[NDArray[np.float32]]:
    """The network's weights, for a file."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(net, eqx.is_inexact_array))]


def network_of(summaries: int, parameters: int, leaves: list[NDArray[np.float32]]) -> PosteriorNetwork:
    """A network with this number of summaries and parameters, and weights from a file. Raises ValueError if their
    shapes do not match."""
    weights, fixed = eqx.partition(PosteriorNetwork(summaries, parameters, 0), eqx.is_inexact_array)
    expected = [leaf.shape for leaf in jax.tree.leaves(weights)]
    if (found := [leaf.shape for leaf in leaves]) != expected:
        raise ValueError(f"weights of shapes {found}, not {expected}")
    own = jax.tree.unflatten(jax.tree.structure(weights), [jnp.asarray(leaf, jnp.float32) for leaf in leaves])
    return eqx.combine(own, fixed)


def trained(summaries: Floats, parameters: Floats, noise: SummaryNoise, seed: int) -> tuple[PosteriorNetwork, float]:
    """Trains a network on recordings' summaries (N, s) and parameters (N, p). Also returns its loss, minus the mean log
    density of held-out recordings. Summaries are without noise, which is drawn anew every epoch."""
    random = np.random.default_rng(seed)
    size = len(summaries) // _BATCH * _BATCH or len(summaries)  # few sizes, so that programs are reused
    order = random.permutation(len(summaries))[:size]
    aside = max(1, int(_ASIDE * size))
    x, y = (jnp.asarray(a[order], jnp.float32) for a in (summaries, parameters))
    held_out = tuple(np.tile(a[order[:aside]], (_NOISES_ASIDE, 1)) for a in (summaries, parameters))
    x_aside, y_aside = (
        jnp.asarray(a, jnp.float32) for a in (held_out[0] + noise.drawn(len(held_out[0]), random), held_out[1])
    )
    root, keys = jnp.asarray(noise.root, jnp.float32), jax.random.split(jax.random.key(seed), _EPOCHS)
    net = PosteriorNetwork(x.shape[1], y.shape[1], seed)
    steps = max(1, (size - aside) // _BATCH)
    with standard_promotion():
        state, best, least, since = _optimiser(steps).init(eqx.filter(net, eqx.is_inexact_array)), net, np.inf, 0
        for key in keys:
            shuffled = aside + random.permutation(size - aside)
            batches = np.resize(shuffled, (steps, min(_BATCH, len(shuffled))))
            noisy = _with_noise(x, root, noise.span, key)
            net, state = _epoch(net, state, _optimiser(steps), noisy, y, jnp.asarray(batches))
            now, since = float(_loss(net, x_aside, y_aside)), since + 1
            if now < least:
                best, least, since = net, now, 0
            if since > _PATIENCE:
                break
    return best, least


@cache
def _optimiser(steps: int) -> optax.GradientTransformation:
    """Optimiser for this number of steps per epoch; cached, so that programs are reused."""
    return optax.chain(
        optax.clip_by_global_norm(5.0),
        optax.adamw(optax.cosine_decay_schedule(_RATE, _EPOCHS * steps), weight_decay=_DECAY),
    )


@jax.jit
def _with_noise(x: Array, root: Array, span: float, key: Array) -> Array:
    one, other = jax.random.split(key)
    sizes = jnp.float32(span) ** jax.random.uniform(one, (len(x), 1), jnp.float32, -1, 1)
    return x + sizes * jax.random.normal(other, x.shape, jnp.float32) @ root.T


@eqx.filter_jit
def _mixtures(net: PosteriorNetwork, summaries: Array) -> Mixture:
    return jax.vmap(net)(summaries)


@eqx.filter_jit
def _loss(net: PosteriorNetwork, x: Array, y: Array) -> Array:
    return -jnp.mean(jax.vmap(net.log_density)(x, y))


@eqx.filter_jit
def _epoch(
    net: PosteriorNetwork, state: Any, optimiser: optax.GradientTransformation, x: Array, y: Array, batches: Array
) -> tuple[PosteriorNetwork, Any]:
    weights, fixed = eqx.partition(net, eqx.is_inexact_array)

    def step(now: tuple[Any, Any], batch: Array) -> tuple[tuple[Any, Any], None]:
        weights, state = now
        slopes = jax.grad(lambda w: _loss(eqx.combine(w, fixed), x[batch], y[batch]))(weights)
        updates, state = optimiser.update(slopes, state, weights)
        return (optax.apply_updates(weights, updates), state), None

    weights, state = jax.lax.scan(step, (weights, state), batches)[0]
    return eqx.combine(weights, fixed), state
