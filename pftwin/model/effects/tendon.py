"""Tendons and ligament strands: a spring beside a dashpot. They differ in the spring's law alone."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.base import Change, Instant, Load, Observable
from pftwin.model.effects.line_elements import DAMPING, TOE, ElasticLine

TOE_STRAIN = 0.06  # twice the reference strain of Blankevoort & Huiskes 1991, J Biomech Eng 113:263
_NO_TOE = 1e-6  # a negligible toe strain
_LINEAR = "linear from slack, the linear region as it is"


class SpringForce(NamedTuple):
    """A spring law's answer at a stretch."""

    force: Scalar  # [N]
    slope: Scalar  # [N/m]
    energy: Scalar  # stored [J]


class LinearSpring(NamedTuple):
    """F = K s."""

    stiffness: Scalar  # K [N/m]

    def at(self, stretch: Scalar) -> SpringForce:
        """At a stretch [m]; below 0 it would push."""
        return SpringForce(self.stiffness * stretch, self.stiffness, 0.5 * self.stiffness * jnp.square(stretch))


class ToeSpring(NamedTuple):
    r"""The toe region of soft tissue: quadratic while its crimped fibres straighten, then linear; C1.

    F = K s^2 / (2 t) for 0 < s < t, F = K (s - t / 2) beyond, 0 where slack.
    Source: Blankevoort & Huiskes 1991, J Biomech Eng 113:263 (half of t / L0 is their reference strain e1).
    """

    stiffness: Scalar  # K, of the linear region [N/m]
    toe: Scalar  # t, the stretch at which the toe region ends [m]

    def at(self, stretch: Scalar) -> SpringForce:
        """At a stretch [m]."""
        in_toe, s, half = stretch < self.toe, jnp.maximum(stretch, 0.0), 0.5 * self.toe
        force = jnp.where(in_toe, s * s / (2 * self.toe), s - half)
        slope = jnp.where(in_toe, s / self.toe, 1.0)
        energy = jnp.where(in_toe, s**3 / (6 * self.toe), 0.5 * (s - half) ** 2 + self.toe**2 / 24)
        return SpringForce(*(self.stiffness * a for a in (force, slope, energy)))


class DampedLine(ElasticLine):
    """A spring with a dashpot beside it: F = f(L - L0) + c dL/dt, never negative, and nothing where L <= L0.

    A leading axis on every leaf makes a group.
    """

    observables: ClassVar[dict[str, Observable]] = {
        "tension": Observable("N", "tension"),
        "length": Observable("m", "length"),
    }

    if TYPE_CHECKING:

        @property
        def damping(self) -> Scalar: ...  # noqa: D102

    @property
    @abstractmethod
    def law(self) -> LinearSpring | ToeSpring:
        """The spring's law f."""

    @property
    def dashpot(self) -> Scalar:
        """c [N s/m]: the field `damping`, where a subclass does not derive it from another."""
        return self.damping

    @property
    def rest_length(self) -> Scalar:
        """L0 [m]: the field `slack_length`, where a subclass does not derive it from others."""
        return self.slack_length

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Its pull."""
        line = self.line(now)
        stretch, c = line.length - self.rest_length, self.dashpot
        # A tendon that shortens too fast to pull still gives up what it stores: as heat.
        elastic, k, stored = self.law.at(jnp.maximum(stretch, 0.0))
        pull = elastic + c * line.lengthening
        taut = (stretch > 0) & (pull > 0)
        tension, k, c = (jnp.where(taut, a, 0.0) for a in (pull, k, c))
        return Load(stiff=(line.term(tension, elastic, k, c),), energy=jnp.sum(stored)), memory

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`: of the spring; of a linear one negative where it would hang slack."""
        return self.law.at(length - self.rest_length).force

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Tension and length."""
        return self.report(now, memory)[0]

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar | None]:
        """These, and the energy stored."""
        load, _ = self.load(now, memory)
        (term,) = load.stiff
        return {"tension": term.force, "length": self.line(now).length}, load.energy

    def simplifications(self) -> Iterable[Change]:
        """Without its dashpot."""
        undamped = eqx.tree_at(lambda t: t.damping, self, jnp.zeros_like(self.damping))
        return (Change(DAMPING, undamped, "no dashpot"),)


class Tendon(DampedLine):
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
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)

    @property
    def law(self) -> LinearSpring:
        """F = K s."""
        return LinearSpring(self.stiffness)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return length - tension / self.stiffness

    def elaborations(self) -> Iterable[Change]:
        """With a toe region, the linear region as it is."""
        slack, toe = self.slack_length / (1 + 0.5 * TOE_STRAIN), TOE_STRAIN + 0 * self.slack_length
        ends = self.insertion, self.origin, self.body
        stiffening = ToeTendon(self.stiffness, slack, toe, self.damping, *ends, wrap=self.wrap, name=self.name)
        return (Change(TOE, stiffening, f"toe strain {TOE_STRAIN:g}, the linear region as it is"),)


class ToeTendon(DampedLine):
    r"""A tendon that stiffens over a toe region, then is linear, and never pushes.

    The law is that of `ToeSpring` with t = toe strain * L0, plus c dL/dt while taut, never negative. As the toe strain
    tends to 0 this is `Tendon`. A leading axis on every leaf makes a group.
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))  # K, of the linear region
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # L0
    toe_strain: Scalar = eqx.field(metadata=quantity("", positive=True))  # end of the toe region, t / L0
    damping: Scalar = eqx.field(metadata=quantity("N s/m", at_least=0))  # c
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    body: str = eqx.field(static=True)
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)

    @property
    def law(self) -> ToeSpring:
        """With a toe region that is a part of the slack length."""
        return ToeSpring(self.stiffness, self.toe_strain * self.slack_length)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: the law solved for L0 in its toe region and beyond."""
        f, toe = tension / self.stiffness, self.toe_strain
        linear = (length - f) / (1 + 0.5 * toe)
        in_toe = length + toe * f - safe_sqrt(toe * f * (2 * length + toe * f))
        return jnp.where(f < 0.5 * toe * linear, in_toe, linear)

    def simplifications(self) -> Iterable[Change]:
        """Without its toe region: linear from half a toe later, where its linear region's line meets zero; undamped."""
        slack = self.slack_length * (1 + 0.5 * self.toe_strain)
        ends = self.insertion, self.origin, self.body
        linear = Tendon(self.stiffness, slack, self.damping, *ends, wrap=self.wrap, name=self.name)
        return Change(f"{TOE} of tendons", linear, _LINEAR), *super().simplifications()


class StrandGroup(DampedLine):
    r"""Ligament strands that stiffen over a toe region, then are linear, and never push.

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
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)
    observables: ClassVar[dict[str, Observable]] = {"tension": Observable("N", "sum of the strands' tensions")}

    @property
    def law(self) -> ToeSpring:
        """The same per metre: K = k / L0, t = 2 e1 L0."""
        return ToeSpring(self.stiffness / self.slack_length, self.toe_strain * self.slack_length)

    @property
    def dashpot(self) -> Scalar:
        """k c / L0."""
        return self.stiffness * self.damping_time / self.slack_length

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: the law solved for the strain in its toe region and beyond."""
        f, toe = tension / self.stiffness, self.toe_strain
        return length / (1 + jnp.where(f < 0.5 * toe, safe_sqrt(2 * toe * f), f + 0.5 * toe))

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar | None]:
        """Total tension, and the energy stored."""
        shown, energy = super().report(now, memory)
        return {"tension": jnp.sum(shown["tension"])}, energy

    def simplifications(self) -> Iterable[Change]:
        """Without toe regions, the stiffness per metre and the linear region as they are; undamped."""
        longer = (1 + 0.5 * self.toe_strain) / (1 + 0.5 * _NO_TOE)
        new = self.stiffness * longer, self.slack_length * longer, jnp.full_like(self.toe_strain, _NO_TOE)
        linear = eqx.tree_at(lambda s: (s.stiffness, s.slack_length, s.toe_strain), self, new)
        undamped = eqx.tree_at(lambda s: s.damping_time, self, jnp.zeros_like(self.damping_time))
        return Change(f"{TOE} of strands", linear, _LINEAR), Change(DAMPING, undamped, "no dashpot")
