"""Ligament strands with a toe region, one effect for any number of them."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.effects.base import Instant, Load, Observable
from pftwin.effects.strings import Strung
from pftwin.effects.toe_region import toe_region
from pftwin.spatial import Scalar, Vec3


class StrandGroup(Strung):
    r"""Strands that stiffen over a toe region, then are linear, and never push.

    With strain e = (L - L0) / L0 and reference strain e1: F = k e^2 / (4 e1) for 0 < e < 2 e1, F = k (e - e1) beyond,
    plus k c de/dt while taut; k in newtons per unit strain, c in seconds. Every leaf has the strands' axis in front.
    Source: Blankevoort & Huiskes 1991, J Biomech Eng 113:263 (their 2 e1 is the `toe_strain` here).
    """

    stiffness: Scalar  # k [N per unit strain]
    slack_length: Scalar  # L0 [m]
    toe_strain: Scalar  # end of the toe region, 2 e1 [-]
    damping_time: Scalar  # c [s]
    insertion: Vec3
    origin: Vec3
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

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Total tension."""
        (term,) = self.load(now, memory)[0].stiff
        return {"tension": jnp.sum(term.force)}
