"""Prescribed tensions: muscles whose tension over time is measured or comes from another model."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.line_elements import LineElement


class PrescribedTension(LineElement):
    """Lines with prescribed tensions over time, from origins that may move on their body (wrapping muscles).

    `tension` and each coordinate of `origin` have shape (n_samples, n_lines), those of `insertion` (n_lines,). Tension
    and origin are interpolated linearly between samples, and constant before the first and after the last. A tension
    that depends on time alone has no potential: no energy is stored, and its work counts as external work.
    """

    tension: Scalar = eqx.field(metadata=quantity("N", at_least=0))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    start_time: float = eqx.field(static=True)
    interval: float = eqx.field(static=True)  # [s]
    body: str = eqx.field(static=True)
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)
    observables: ClassVar[dict[str, Observable]] = {"tension": Observable("N", "sum of the prescribed tensions")}

    def at(self, time: Scalar | float) -> tuple[Scalar, Vec3]:
        """Tensions [N] and origins [m] at a time [s], each (n_lines,)."""
        position = (time - self.start_time) / self.interval
        last = self.tension.shape[0] - 1
        whole = jnp.clip(jnp.floor(position), 0.0, max(last - 1.0, 0.0))
        index, fraction = jnp.asarray(whole, int), jnp.clip(position - whole, 0.0, 1.0)

        def sample(series: Scalar) -> Scalar:
            return series[index] + fraction * (series[jnp.minimum(index + 1, last)] - series[index])

        return jax.tree.map(sample, (self.tension, self.origin))

    def origin_at(self, time: Scalar | float) -> Vec3:
        """Origins of the lines at a time [s], in their body's frame [m]."""
        return self.at(time)[1]

    def pulls(self) -> Any:
        """Which lines (n_lines,) have a tension above zero at some sample."""
        return np.any(np.asarray(self.tension) > 0, axis=0)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: a wrench without stiff terms, as the tensions do not depend on the state."""
        tension, line = self.at(now.time)[0], self.line(now)
        zero = jnp.zeros_like(tension)
        term = line.term(tension, tension, zero, zero)
        return Load(wrench=term.wrench()), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Total tension."""
        return {"tension": jnp.sum(self.at(now.time)[0])}
