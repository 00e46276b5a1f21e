"""Tendons and ligament strands as a spring in parallel with a dashpot. They differ only in the spring's law."""

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
    """Force of a spring at a stretch."""

    force: Scalar  # [N]
    slope: Scalar  # derivative with respect to the stretch [N/m]
    energy: Scalar  # stored [J]


class LinearSpring(NamedTuple):
    """F = K s."""

    stiffness: Scalar  # K [N/m]

    def at(self, stretch: Scalar) -> SpringForce:
        """Force at a stretch [m]; negative where the stretch is."""
        return SpringForce(self.stiffness * stretch, self.stiffness, 0.5 * self.stiffness * jnp.square(stretch))


class ToeSpring(NamedTuple):
    r"""Spring with a toe region, as in soft tissue: quadratic while crimped fibres straighten, then linear; C1.

    F = K s^2 / (2 t) for 0 < s < t, F = K (s - t / 2) beyond, 0 where slack.
    Source: Blankevoort & Huiskes 1991, J Biomech Eng 113:263 (half of t / L0 is their reference strain e1).
    """

    stiffness: Scalar  # K, of the linear region [N/m]
    toe: Scalar  # t, the stretch at which the toe region ends [m]

    def at(self, stretch: Scalar) -> SpringForce:
        """Force at a stretch [m]."""
        in_toe, s, half = stretch < self.toe, jnp.maximum(stretch, 0.0), 0.5 * self.toe
        force = jnp.where(in_toe, s * s / (2 * self.toe), s - half)
        slope = jnp.where(in_toe, s / self.toe, 1.0)
        energy = jnp.where(in_toe, s**3 / (6 * self.toe), 0.5 * (s - half) ** 2 + self.toe**2 / 24)
        return SpringForce(*(self.stiffness * a for a in (force, slope, energy)))


class DampedLine(ElasticLine):
    """Spring and dashpot in parallel: F = f(L - L0) + c dL/dt, at least 0, and 0 where L <= L0.

    With a leading axis on every leaf, this is a group of lines.
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
        """Law f of the spring."""

    @property
    def dashpot(self) -> Scalar:
        """c [N s/m]: the field `damping` unless overridden."""
        return self.damping

    @property
    def rest_length(self) -> Scalar:
        """L0 [m]: the field `slack_length` unless overridden."""
        return self.slack_length

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: the tensions as stiff terms."""
        line = self.line(now)
        stretch, c = line.length - self.rest_length, self.dashpot
        # A tendon that shortens too fast to bear tension still releases its stored energy, as heat.
        elastic, k, stored = self.law.at(jnp.maximum(stretch, 0.0))
        pull = elastic + c * line.lengthening
        taut = (stretch > 0) & (pull > 0)
        tension, k, c = (jnp.where(taut, a, 0.0) for a in (pull, k, c))
        return Load(stiff=(line.term(tension, elastic, k, c),), energy=jnp.sum(stored)), memory

    def held_tension(self, length: Scalar) -> Scalar:
        """See `ElasticLine`: tension of the spring alone [N]; of a linear spring, negative where the line is slack."""
        return self.law.at(length - self.rest_length).force

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """See `Effect`: tension [N] and length [m]."""
        return self.report(now, memory)[0]

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar | None]:
        """See `Effect`: tension [N] and length [m], and the stored energy [J]."""
        load, _ = self.load(now, memory)
        (term,) = load.stiff
        return {"tension": term.force, "length": self.line(now).length}, load.energy

    def simplifications(self) -> Iterable[Change]:
        """See `Effect`: the line without its dashpot."""
        undamped = eqx.tree_at(lambda t: t.damping, self, jnp.zeros_like(self.damping))
        return (Change(DAMPING, undamped, "no dashpot"),)


class Tendon(DampedLine):
    r"""Linear spring and dashpot in parallel between the patella and a guided body, without compression.

    F = K (L - L0) + c dL/dt, at least 0, and 0 where L <= L0. With a leading axis on every leaf, this is a group.
    Source: Michaud et al. 2024, eq. 1 (there c = 0.01 s * K; the damping term has the sign that mechanics requires).
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
        """Linear spring F = K s."""
        return LinearSpring(self.stiffness)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`."""
        return length - tension / self.stiffness

    def elaborations(self) -> Iterable[Change]:
        """See `Effect`: the tendon with a toe region and an unchanged linear region."""
        slack, toe = self.slack_length / (1 + 0.5 * TOE_STRAIN), TOE_STRAIN + 0 * self.slack_length
        ends = self.insertion, self.origin, self.body
        stiffening = ToeTendon(self.stiffness, slack, toe, self.damping, *ends, wrap=self.wrap, name=self.name)
        return (Change(TOE, stiffening, f"toe strain {TOE_STRAIN:g}, the linear region as it is"),)


class ToeTendon(DampedLine):
    r"""A tendon whose stiffness rises over a toe region and is then constant, without compression.

    The law is that of `ToeSpring` with t = toe strain * L0, plus c dL/dt while taut, at least 0. As the toe strain
    tends to 0 it becomes `Tendon`. With a leading axis on every leaf, this is a group.
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
        """Toe spring; its toe region is a fraction of the slack length."""
        return ToeSpring(self.stiffness, self.toe_strain * self.slack_length)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: the law solved for L0 in its toe region and beyond."""
        f, toe = tension / self.stiffness, self.toe_strain
        linear = (length - f) / (1 + 0.5 * toe)
        in_toe = length + toe * f - safe_sqrt(toe * f * (2 * length + toe * f))
        return jnp.where(f < 0.5 * toe * linear, in_toe, linear)

    def simplifications(self) -> Iterable[Change]:
        """See `Effect`: linear, slack up to where the linear region extrapolates to zero force; without the dashpot."""
        slack = self.slack_length * (1 + 0.5 * self.toe_strain)
        ends = self.insertion, self.origin, self.body
        linear = Tendon(self.stiffness, slack, self.damping, *ends, wrap=self.wrap, name=self.name)
        return Change(f"{TOE} of tendons", linear, _LINEAR), *super().simplifications()


class StrandGroup(DampedLine):
    r"""Ligament strands whose stiffness rises over a toe region and is then constant, without compression.

    With strain e = (L - L0) / L0 and reference strain e1: F = k e^2 / (4 e1) for 0 < e < 2 e1, F = k (e - e1) beyond,
    plus k c de/dt while taut; k in newtons per unit strain, c in seconds. The first axis of every leaf is the strand.
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
        """Toe spring in terms of length: K = k / L0, t = 2 e1 L0."""
        return ToeSpring(self.stiffness / self.slack_length, self.toe_strain * self.slack_length)

    @property
    def dashpot(self) -> Scalar:
        """k c / L0 [N s/m]."""
        return self.stiffness * self.damping_time / self.slack_length

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: the law solved for the strain in its toe region and beyond."""
        f, toe = tension / self.stiffness, self.toe_strain
        return length / (1 + jnp.where(f < 0.5 * toe, safe_sqrt(2 * toe * f), f + 0.5 * toe))

    def report(self, now: Instant, memory: Any) -> tuple[dict[str, Scalar], Scalar | None]:
        """See `Effect`: total tension [N], and the stored energy [J]."""
        shown, energy = super().report(now, memory)
        return {"tension": jnp.sum(shown["tension"])}, energy

    def simplifications(self) -> Iterable[Change]:
        """See `Effect`: without toe regions, with the same linear region and stiffness per metre; without dashpots."""
        longer = (1 + 0.5 * self.toe_strain) / (1 + 0.5 * _NO_TOE)
        new = self.stiffness * longer, self.slack_length * longer, jnp.full_like(self.toe_strain, _NO_TOE)
        linear = eqx.tree_at(lambda s: (s.stiffness, s.slack_length, s.toe_strain), self, new)
        undamped = eqx.tree_at(lambda s: s.damping_time, self, jnp.zeros_like(self.damping_time))
        return Change(f"{TOE} of strands", linear, _LINEAR), Change(DAMPING, undamped, "no dashpot")
