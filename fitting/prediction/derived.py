"""Quantities derived from fitted parameters: any function of the scene, with the parameters' uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fitting.prediction.predicting import Fitted, check_draws, estimate_and_draws
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene, check

_AT_ONCE = 256  # draws computed in one batch
_FAILED = 0.05  # largest share of draws that may give no finite number


class Derived(NamedTuple):
    """A number or array derived from fitted parameters.

    value: at the estimate's values (...).
    draws: at draws from the estimate, those that gave finite numbers (N, ...).
    failed: number of draws that did not.
    doubts: about the estimate, which make this INVALID too.
    coverage: measured coverage of intervals of such estimates, in words.
    """

    value: Floats
    draws: Floats
    failed: int
    doubts: tuple[str, ...]
    coverage: str

    @property
    def standard_deviation(self) -> Floats:
        """Standard deviation of the draws (...)."""
        return self.draws.std(axis=0, ddof=1)

    def interval(self, level: float = 0.95) -> Floats:
        """Central interval of the draws, lower and upper end (2, ...).

        Raises:
            InputError: a level outside 0 to 1.
        """
        if not 0 < level < 1:
            raise InputError(f"found {level!r}", where="level", expected="between 0 and 1")
        return np.quantile(self.draws, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)


def derived(
    estimate: Fitted, function: Callable[[Scene], Any], scene: Scene, samples: int = 2000, seed: int = 0
) -> Derived:
    """A function of fitted parameters with its uncertainty: `derived(estimate, lambda s: s.get("K1") ** 2, scene)`.

    Args:
        estimate: a `fitting.Estimate`, or another that `predict` takes.
        function: pure function of a scene that returns an array: a ratio, a tension, something of
            `pftwin.trajectory(scene)` (whose status you must check yourself).
        scene: scene to which the fitted values are applied.
        samples: number of draws, at least 2.
        seed: of the draws.

    Raises:
        InputError: too few samples; a scene that cannot have these values; a function without finite numbers at the
            estimate's values, or for more than a twentieth of the draws.
    """
    check_draws(samples, estimate)
    if samples < 2:
        raise InputError(f"found {samples}", where="samples", expected="at least 2")
    apply = estimate.apply
    check(apply(scene))

    @eqx.filter_jit
    def computed(thetas: jax.Array) -> jax.Array:
        return jax.lax.map(lambda t: jnp.asarray(function(apply(scene, t))), thetas, batch_size=_AT_ONCE)

    thetas = estimate_and_draws(estimate, samples, seed)
    padded = np.resize(thetas, (-(-len(thetas) // _AT_ONCE) * _AT_ONCE, thetas.shape[1]))  # avoids a second compilation
    found = np.asarray(computed(jnp.asarray(padded)))[: len(thetas)]
    finite = np.asarray(np.isfinite(found).reshape(len(found), -1).all(axis=1))
    failed = int((~finite[1:]).sum())
    if not finite[0] or failed > _FAILED * samples:
        what = f"not finite in {failed} of {samples} draws" if finite[0] else "not finite at the estimate's values"
        raise InputError(what, where="function", expected="finite numbers")
    return Derived(found[0], found[1:][finite[1:]], failed, tuple(estimate.doubts), estimate.coverage.intervals)
