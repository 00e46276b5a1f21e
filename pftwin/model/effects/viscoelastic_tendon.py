"""Viscoelastic tendons: stiffer the faster they are pulled, and slacker the longer they are held."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.line_elements import ElasticLine, Line
from pftwin.model.effects.standard_linear_solid import RELAXED, SolidPull, StandardLinearSolid


class ViscoelasticTendon(ElasticLine):
    r"""A tendon that is a standard linear solid; it pulls or hangs slack.

    F = K s + K1 (s - e), de/dt = (s - e) / tau, with s = L - L0, never negative. A tendon that is stretched at once and
    held relaxes from (K + K1) s to K s as exp(-t / tau). The dashpot's stretch e is memory: a motion starts with every
    dashpot relaxed, as an equilibrium is. A leading axis on every leaf makes a group. Law, integration over a step and
    sources: `pftwin.model.effects.standard_linear_solid`.
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))  # K, when relaxed
    maxwell_stiffness: Scalar = eqx.field(metadata=quantity("N/m", at_least=0))  # K1, more when pulled at once
    relaxation_time: Scalar = eqx.field(metadata=quantity("s", positive=True))  # tau
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # L0
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)
    observables: ClassVar[dict[str, Observable]] = {
        "tension": Observable("N", "tension"),
        "length": Observable("m", "length"),
        "dashpot_stretch": Observable("m", "stretch of the dashpot"),
    }

    @property
    def solid(self) -> StandardLinearSolid:
        """The law."""
        return StandardLinearSolid(self.stiffness, self.maxwell_stiffness, self.relaxation_time)

    def remember(self, now: Instant) -> Scalar:
        """A dashpot that is relaxed at this length."""
        return jnp.maximum(self.line(now).length - self.slack_length, 0.0)

    def guess(self, now: Instant) -> Scalar:
        """A dashpot that is relaxed whatever the length: an equilibrium is looked for among such."""
        return RELAXED * jnp.ones_like(self.line(now).length)

    def load(self, now: Instant, memory: Scalar) -> tuple[Load, Scalar]:
        """Its pull, and the dashpot one step later.

        That is where the present velocity leads in the step. What the step does to the velocity moves the dashpot
        in the second order only, and what it does to the tension is in the stiffness.
        """
        line = self.line(now)
        stretch = line.length - self.slack_length
        if not isinstance(now.lookahead, float):  # the end of a step, seen from its start
            pull = self.solid.over(stretch - now.lookahead * line.lengthening, stretch, memory, now.lookahead)
            return self._load(line, pull), pull.dashpot
        pull = self.solid.at(stretch, memory)
        if isinstance(now.step, float) and now.step == 0.0:
            return self._load(line, pull), memory
        later = self.solid.over(stretch, stretch + now.step * line.lengthening, memory, now.step)
        return self._load(line, pull), later.dashpot

    def _load(self, line: Line, pull: SolidPull) -> Load:
        # The tension is all elastic: what the dashpot loses does not depend on how fast the ends move apart.
        term = line.term(pull.tension, pull.tension, pull.stiffness, jnp.zeros_like(pull.tension))
        return Load(stiff=(term,), energy=jnp.sum(pull.energy), heat=jnp.sum(pull.heat))

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`: of the spring, negative where it would hang slack."""
        return self.stiffness * (length - self.slack_length)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return length - tension / self.stiffness

    def observe(self, now: Instant, memory: Scalar) -> dict[str, Scalar]:
        """Tension, length and the dashpot's stretch."""
        line = self.line(now)
        stretch = line.length - self.slack_length
        pull = self.solid.at(stretch, memory)
        return {
            "tension": pull.tension,
            "length": line.length,
            "dashpot_stretch": self.solid.resting(stretch, memory),
        }
