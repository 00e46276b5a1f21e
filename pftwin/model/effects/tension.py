"""Prescribed tensions: muscles whose tension was measured or computed elsewhere."""

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
    """Lines that pull with tensions given over time, from origins that may move on their body (wrapping muscles).

    `tension` has shape (n_samples, n_lines), `origin` the same per coordinate, `insertion` (n_lines,). Between samples
    both are interpolated linearly; before the first and after the last they stay. A tension that depends on time alone
    has no potential: `energy` is 0, and its work counts as external work.
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
        """Tensions and origins at an instant."""
        position = (time - self.start_time) / self.interval
        last = self.tension.shape[0] - 1
        whole = jnp.clip(jnp.floor(position), 0.0, max(last - 1.0, 0.0))
        index, fraction = jnp.asarray(whole, int), jnp.clip(position - whole, 0.0, 1.0)

        def sample(series: Scalar) -> Scalar:
            return series[index] + fraction * (series[jnp.minimum(index + 1, last)] - series[index])

        return jax.tree.map(sample, (self.tension, self.origin))

    def origin_at(self, time: Scalar | float) -> Vec3:
        """Where the lines leave their body at an instant [m]."""
        return self.at(time)[1]

    def pulls(self) -> Any:
        """Those whose tension is not zero throughout."""
        return np.any(np.asarray(self.tension) > 0, axis=0)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """The tensions' forces; their slopes are zero, so none of them is stiff."""
        tension, line = self.at(now.time)[0], self.line(now)
        zero = jnp.zeros_like(tension)
        term = line.term(tension, tension, zero, zero)
        return Load(wrench=term.wrench()), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Total tension."""
        return {"tension": jnp.sum(self.at(now.time)[0])}
