"""Tendons with a toe region: soft at first, then linear."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.model.effects.base import Change, Instant, Load, Observable
from pftwin.model.effects.line_elements import DAMPING, TOE, ElasticLine
from pftwin.model.effects.tendon import Tendon
from pftwin.model.effects.toe_region import toe_region


class ToeTendon(ElasticLine):
    r"""A tendon that stiffens over a toe region, then is linear, and never pushes.

    With stretch s = L - L0 and the toe's end t = toe strain * L0: F = K s^2 / (2 t) for 0 < s < t, F = K (s - t / 2)
    beyond, plus c dL/dt while taut, never negative. As the toe strain tends to 0 this is `Tendon`. A leading axis on
    every leaf makes a group. Source: Blankevoort & Huiskes 1991, J Biomech Eng 113:263, there by strain.
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))  # K, of the linear region
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # L0
    toe_strain: Scalar = eqx.field(metadata=quantity("", positive=True))  # end of the toe region, t / L0
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
        toe = toe_region(stretch, self.toe_strain * self.slack_length)
        # A tendon that shortens too fast to pull still gives up what it stores: as heat.
        elastic = self.stiffness * toe.force
        pull = elastic + self.damping * line.lengthening
        taut = (stretch > 0) & (pull > 0)
        tension, k, c = (jnp.where(taut, a, 0.0) for a in (pull, self.stiffness * toe.slope, self.damping))
        return Load(stiff=(line.term(tension, elastic, k, c),), energy=jnp.sum(self.stiffness * toe.energy)), memory

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return self.stiffness * toe_region(length - self.slack_length, self.toe_strain * self.slack_length).force

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: the law solved for L0 in its toe region and beyond."""
        f, toe = tension / self.stiffness, self.toe_strain
        linear = (length - f) / (1 + 0.5 * toe)
        in_toe = length + toe * f - safe_sqrt(toe * f * (2 * length + toe * f))
        return jnp.where(f < 0.5 * toe * linear, in_toe, linear)

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Tension and length."""
        (term,) = self.load(now, memory)[0].stiff
        return {"tension": term.force, "length": self.line(now).length}

    def simplifications(self) -> Iterable[Change]:
        """Without its toe region: linear from half a toe later, where its linear region's line meets zero; undamped."""
        slack = self.slack_length * (1 + 0.5 * self.toe_strain)
        linear = Tendon(self.stiffness, slack, self.damping, self.insertion, self.origin, self.body, name=self.name)
        undamped = eqx.tree_at(lambda t: t.damping, self, jnp.zeros_like(self.damping))
        how = "linear from slack, the linear region as it is"
        return Change(f"{TOE} of tendons", linear, how), Change(DAMPING, undamped, "no dashpot")
