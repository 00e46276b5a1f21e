"""What follows from fitted parameters: any function of the scene, as uncertain as they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitting.prediction.predicting import Fitted, check_draws, estimate_and_draws
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene

Floats = NDArray[np.float64]

_AT_ONCE = 256  # draws whose values are computed together


class Derived(NamedTuple):
    """A number, or an array of them, that follows from fitted parameters.

    value: at the estimate's values (...).
    draws: at parameters as uncertain as the estimate (N, ...).
    doubts: what forbids to believe the estimate, and so this.
    coverage: how often intervals of such estimates hold, in words.
    """

    value: Floats
    draws: Floats
    doubts: tuple[str, ...]
    coverage: str

    @property
    def standard_deviation(self) -> Floats:
        """Of the draws (...)."""
        return self.draws.std(axis=0, ddof=1)

    def interval(self, level: float = 0.95) -> Floats:
        """Between which values the middle draws lie (2, ...).

        Raises:
            InputError: a level that is none.
        """
        if not 0 < level < 1:
            raise InputError(f"found {level!r}", where="level", expected="between 0 and 1")
        return np.quantile(self.draws, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)


def derived(
    estimate: Fitted, function: Callable[[Scene], Any], scene: Scene, samples: int = 2000, seed: int = 0
) -> Derived:
    """What follows from an estimate's parameters: `derived(estimate, lambda s: s.get("K1") / s.get("K2"), scene)`.

    Args:
        estimate: `fitting.Estimate`, or another that `predict` takes.
        function: of a scene, pure, that gives an array: a ratio, a tension, something of `pftwin.trajectory(scene)`.
        scene: that is given the fitted values.
        samples: how many draws, at least 2.
        seed: of the draws.

    Raises:
        InputError: too few samples; a function that gives numbers that are not finite.
    """
    check_draws(samples, estimate)
    if samples < 2:
        raise InputError(f"found {samples}", where="samples", expected="at least 2")
    apply = estimate.apply

    @eqx.filter_jit
    def computed(thetas: jax.Array) -> jax.Array:
        return jax.lax.map(lambda t: jnp.asarray(function(apply(scene, t))), thetas, batch_size=_AT_ONCE)

    found = np.asarray(computed(jnp.asarray(estimate_and_draws(estimate, samples, seed))))
    if bad := int((~np.isfinite(found).reshape(len(found), -1).all(axis=1)).sum()):
        raise InputError(f"not finite in {bad} of {len(found)} draws", where="function", expected="finite numbers")
    return Derived(found[0], found[1:], tuple(estimate.doubts), estimate.coverage.intervals)
