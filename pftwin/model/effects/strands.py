"""Ligament strands with a toe region, one effect for any number of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.model.effects.base import Change, Instant, Load, Observable
from pftwin.model.effects.line_elements import DAMPING, TOE, ElasticLine
from pftwin.model.effects.toe_region import toe_region

_NO_TOE = 1e-6  # strain at which the toe ends: as good as none


class StrandGroup(ElasticLine):
    r"""Strands that stiffen over a toe region, then are linear, and never push.

    With strain e = (L - L0) / L0 and reference strain e1: F = k e^2 / (4 e1) for 0 < e < 2 e1, F = k (e - e1) beyond,
    plus k c de/dt while taut; k in newtons per unit strain, c in seconds. Every leaf has the strands' axis in front.
    Source: Blankevoort & Huiskes 1991, J Biomech Eng 113:263 (their 2 e1 is the `toe_strain` here).
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N per unit strain", positive=True, alias="K"))  # k
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # L0
    toe_strain: Scalar = eqx.field(metadata=quantity("", positive=True))  # end of the toe region, 2 e1
    damping_time: Scalar = eqx.field(metadata=quantity("s", at_least=0))  # c
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)
    observables: ClassVar[dict[str, Observable]] = {"tension": Observable("N", "sum of the strands' tensions")}

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """All strands' pulls as one group of stiff terms."""
        line = self.line(now)
        strain = (line.length - self.slack_length) / self.slack_length
        toe = toe_region(strain, self.toe_strain)
        elastic = self.stiffness * toe.force
        slope = (self.stiffness / self.slack_length) * toe.slope
        viscous = jnp.where(strain > 0, self.stiffness * self.damping_time / self.slack_length, 0.0)
        tension = elastic + viscous * line.lengthening
        taut = tension > 0
        tension, slope, viscous = (jnp.where(taut, a, 0.0) for a in (tension, slope, viscous))
        stored = self.stiffness * self.slack_length * toe.energy
        return Load(stiff=(line.term(tension, elastic, slope, viscous),), energy=jnp.sum(stored)), memory

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return self.stiffness * toe_region(length / self.slack_length - 1, self.toe_strain).force

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: the law solved for the strain in its toe region and beyond."""
        f, toe = tension / self.stiffness, self.toe_strain
        return length / (1 + jnp.where(f < 0.5 * toe, safe_sqrt(2 * toe * f), f + 0.5 * toe))

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Total tension."""
        (term,) = self.load(now, memory)[0].stiff
        return {"tension": jnp.sum(term.force)}

    def simplifications(self) -> Iterable[Change]:
        """Without toe regions, the stiffness per metre and the linear region as they are; undamped."""
        longer = (1 + 0.5 * self.toe_strain) / (1 + 0.5 * _NO_TOE)
        new = self.stiffness * longer, self.slack_length * longer, jnp.full_like(self.toe_strain, _NO_TOE)
        linear = eqx.tree_at(lambda s: (s.stiffness, s.slack_length, s.toe_strain), self, new)
        undamped = eqx.tree_at(lambda s: s.damping_time, self, jnp.zeros_like(self.damping_time))
        how = "linear from slack, the linear region as it is"
        return Change(f"{TOE} of strands", linear, how), Change(DAMPING, undamped, "no dashpot")
