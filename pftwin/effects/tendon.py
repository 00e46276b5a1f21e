"""Tendons as linear spring-dampers."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.effects.base import Instant, Load, Observable
from pftwin.effects.strings import ElasticLine
from pftwin.quantities import quantity
from pftwin.spatial import Scalar, Vec3


class Tendon(ElasticLine):
    r"""A spring-damper between the patella and a guided body; it pulls or hangs slack.

    F = K (L - L0) + c dL/dt, never negative, and nothing where L <= L0. A leading axis on every leaf makes a group.
    Source: Michaud et al. 2024, eq. 1 (there c = 0.01 s * K; the sign of the damping term is that of its mechanics).
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))  # K
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # L0
    damping: Scalar = eqx.field(metadata=quantity("N s/m", at_least=0))  # c
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)
    observables: ClassVar[dict[str, Observable]] = {
        "tension": Observable("N", "tension"),
        "length": Observable("m", "length"),
    }

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Its pull."""
        line = self.line(now)
        stretch = line.length - self.slack_length
        pull = self.stiffness * stretch + self.damping * line.lengthening
        taut = (stretch > 0) & (pull > 0)
        tension, k, c = (jnp.where(taut, a, 0.0) for a in (pull, self.stiffness, self.damping))
        stretched = jnp.maximum(stretch, 0.0)
        # A tendon that shortens too fast to pull still gives up what it stores: as heat.
        elastic = self.stiffness * stretched
        stored = 0.5 * jnp.sum(self.stiffness * jnp.square(stretched))
        return Load(stiff=(line.term(tension, elastic, k, c),), energy=stored), memory

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`: of the spring, negative where it would hang slack."""
        return self.stiffness * (length - self.slack_length)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return length - tension / self.stiffness

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Tension and length."""
        (term,) = self.load(now, memory)[0].stiff
        return {"tension": term.force, "length": self.line(now).length}
