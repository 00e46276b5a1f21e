r"""Tendons as standard linear solids, whose stiffness grows with the rate of stretch and whose tension relaxes.

A spring in parallel with a spring and dashpot in series, without compression: see `ViscoelasticTendon` for the
symbols. Here x is the stretch of the material, which equals s while the tendon is taut. Where F would be negative the
tendon is slack: the material is longer than the distance of its ends, so it bears no tension, x = K1 e / (K + K1), and
it shortens as the dashpot recovers. The stored energy is (K x^2 + K1 (x - e)^2) / 2, the heat rate K1 (x - e)^2 / tau.

Over a step, de/dt is integrated exactly for a stretch that is linear in time (exponential integrator: Simo & Hughes
1998, Computational Inelasticity, chapter 10). Source of the model: Fung 1993, Biomechanics: Mechanical Properties of
Living Tissues, chapter 2 (there the Kelvin body).
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.line_elements import ElasticLine, Line

RELAXED = -1.0  # marks a dashpot that is relaxed at any length; actual stretches of a dashpot are never negative [m]


class SolidPull(NamedTuple):
    """Tension of the solid at an instant or at the end of a step."""

    tension: Scalar  # [N]
    stiffness: Scalar  # dF/dx: instantaneous, or over a step during which the dashpot moves [N/m]
    energy: Scalar  # stored [J]
    heat: Scalar  # power dissipated in the dashpot, averaged over a step [W]
    dashpot: Scalar  # e [m]


class StandardLinearSolid(eqx.Module):
    """Parameters and response of a standard linear solid."""

    stiffness: Scalar  # K, fully relaxed [N/m]
    maxwell_stiffness: Scalar  # K1, of the spring in series with the dashpot [N/m]
    relaxation_time: Scalar  # tau, of the relaxation of tension at a constant stretch [s]

    def resting(self, stretch: Scalar, dashpot: Scalar) -> Scalar:
        """The dashpot's stretch [m]; `RELAXED` becomes the actual stretch, at least 0."""
        return jnp.where(dashpot < 0, jnp.maximum(stretch, 0.0), dashpot)

    def at(self, stretch: Scalar, dashpot: Scalar) -> SolidPull:
        """Tension at an instant; a `RELAXED` dashpot follows the stretch, so the stiffness is the long-term one."""
        e = self.resting(stretch, dashpot)
        at_once = self.stiffness + self.maxwell_stiffness
        loose = self.maxwell_stiffness * e / at_once
        taut, material = stretch > loose, jnp.maximum(stretch, loose)
        pull = self.stiffness * stretch + self.maxwell_stiffness * (stretch - e)
        slope = jnp.where(dashpot < 0, self.stiffness, at_once)
        heat = self.maxwell_stiffness * jnp.square(material - e) / self.relaxation_time
        tension, stiffness = (jnp.where(taut, a, 0.0) for a in (pull, slope))
        return SolidPull(tension, stiffness, self._energy(material, e), heat, dashpot)

    def over(self, start: Scalar, end: Scalar, dashpot: Scalar, duration: Scalar | float) -> SolidPull:
        """Tension at the end of an interval in which the stretch changes linearly from `start` to `end`.

        Args:
            start, end: stretch [m], negative where the distance of the ends is below the slack length.
            dashpot: stretch of the dashpot at the start [m], or `RELAXED`.
            duration: length of the interval [s]; 0 changes nothing.
        """
        e = self.resting(start, dashpot)
        z = jnp.maximum(duration / self.relaxation_time, 1e-9)
        left = jnp.exp(-z)
        mean = -jnp.expm1(-z) / z
        of_start, of_end = mean - left, 1 - mean
        ratio = self.maxwell_stiffness / (self.stiffness + self.maxwell_stiffness)
        began = jnp.maximum(start, ratio * e)
        rest = e + of_start * (began - e) - of_end * e
        loose = ratio * rest / (1 - of_end * ratio)  # the material's stretch at the end without tension
        ends = jnp.maximum(end, loose)
        after = rest + of_end * ends
        taut = end > loose
        pull = self.stiffness * end + self.maxwell_stiffness * (end - after)
        slope = self.stiffness + self.maxwell_stiffness * (1 - of_end)
        # The stretch of the spring in series: its mean over the interval is exact; its mean square is that of the
        # parabola with the same start, mean and end.
        average = (after - e) / z
        first, last = began - e, ends - after
        bow = 0.5 * (first + last) - average
        square = jnp.square(average) + jnp.square(last - first) / 12 + jnp.square(bow) / 5
        heat = self.maxwell_stiffness * square / self.relaxation_time
        tension, stiffness = (jnp.where(taut, a, 0.0) for a in (pull, slope))
        return SolidPull(tension, stiffness, self._energy(ends, after), heat, after)

    def _energy(self, material: Scalar, dashpot: Scalar) -> Scalar:
        """Energy stored in both springs [J]."""
        return 0.5 * (self.stiffness * jnp.square(material) + self.maxwell_stiffness * jnp.square(material - dashpot))


class ViscoelasticTendon(ElasticLine):
    r"""A tendon as a standard linear solid, without compression.

    F = K s + K1 (s - e), at least 0, with de/dt = (s - e) / tau and s = L - L0. After a step of stretch, the tension
    relaxes from (K + K1) s to K s as exp(-t / tau). The dashpot's stretch e is memory: a motion starts with every
    dashpot relaxed, as in equilibrium. With a leading axis on every leaf, this is a group.
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))  # K, fully relaxed
    maxwell_stiffness: Scalar = eqx.field(metadata=quantity("N/m", at_least=0))  # K1, in addition when fast
    relaxation_time: Scalar = eqx.field(metadata=quantity("s", positive=True))  # tau
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # L0
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)
    observables: ClassVar[dict[str, Observable]] = {
        "tension": Observable("N", "tension"),
        "length": Observable("m", "length"),
        "dashpot_stretch": Observable("m", "stretch of the dashpot"),
    }

    @property
    def law(self) -> StandardLinearSolid:
        """The solid with this tendon's parameters."""
        return StandardLinearSolid(self.stiffness, self.maxwell_stiffness, self.relaxation_time)

    def remember(self, now: Instant) -> Scalar:
        """See `Effect`: a dashpot that is relaxed at the present length."""
        return jnp.maximum(self.line(now).length - self.slack_length, 0.0)

    def guess(self, now: Instant) -> Scalar:
        """See `Effect`: a dashpot that is relaxed at any length, as in the search for equilibrium."""
        return RELAXED * jnp.ones_like(self.line(now).length)

    def load(self, now: Instant, memory: Scalar) -> tuple[Load, Scalar]:
        """See `Effect`: the tension, and the dashpot's stretch one step later.

        The dashpot advances with the present velocity. The change of velocity over the step affects the dashpot only
        to second order; its effect on the tension is in the stiffness.
        """
        line = self.line(now)
        stretch = line.length - self.slack_length
        if now.ends_a_step:
            pull = self.law.over(stretch - now.lookahead * line.lengthening, stretch, memory, now.lookahead)
            return self._load(line, pull), pull.dashpot
        pull = self.law.at(stretch, memory)
        if isinstance(now.step, float) and now.step == 0.0:
            return self._load(line, pull), memory
        later = self.law.over(stretch, stretch + now.step * line.lengthening, memory, now.step)
        return self._load(line, pull), later.dashpot

    def _load(self, line: Line, pull: SolidPull) -> Load:
        # All tension counts as elastic, since the dashpot's dissipation does not depend on the speed of the ends.
        term = line.term(pull.tension, pull.tension, pull.stiffness, jnp.zeros_like(pull.tension))
        return Load(stiff=(term,), energy=jnp.sum(pull.energy), heat=jnp.sum(pull.heat))

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`: tension when fully relaxed [N], negative where the line is slack."""
        return self.stiffness * (length - self.slack_length)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return length - tension / self.stiffness

    def observe(self, now: Instant, memory: Scalar) -> dict[str, Scalar]:
        """See `Effect`: tension [N], length [m] and the dashpot's stretch [m]."""
        line = self.line(now)
        stretch = line.length - self.slack_length
        pull = self.law.at(stretch, memory)
        return {
            "tension": pull.tension,
            "length": line.length,
            "dashpot_stretch": self.law.resting(stretch, memory),
        }
