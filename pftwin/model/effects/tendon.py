"""Tendons as linear spring-dampers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Change, Instant, Load, Observable
from pftwin.model.effects.line_elements import DAMPING, TOE, ElasticLine

TOE_STRAIN = 0.06  # twice the reference strain of Blankevoort & Huiskes 1991, J Biomech Eng 113:263


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

    def simplifications(self) -> Iterable[Change]:
        """Without its dashpot."""
        undamped = eqx.tree_at(lambda t: t.damping, self, jnp.zeros_like(self.damping))
        return (Change(DAMPING, undamped, "no dashpot"),)

    def elaborations(self) -> Iterable[Change]:
        """With a toe region, the linear region as it is."""
        from pftwin.model.effects.toe_tendon import ToeTendon  # which derives its own simplification from this class

        slack, toe = self.slack_length / (1 + 0.5 * TOE_STRAIN), TOE_STRAIN + 0 * self.slack_length
        ends = self.insertion, self.origin, self.body
        stiffening = ToeTendon(self.stiffness, slack, toe, self.damping, *ends, name=self.name)
        return (Change(TOE, stiffening, f"toe strain {TOE_STRAIN:g}, the linear region as it is"),)
