"""Normal contact laws: force, its derivatives and energy as functions of indentation and its rate.

Each law is F = k d^p (1 + x dd/dt), at least 0. The laws differ in the damping factor x:

| law | x | source |
|---|---|---|
| Hertz | 0 | Hertz 1882 |
| HuntCrossley | 3/2 alpha | Hunt & Crossley 1975 |
| Flores | 8 (1 - e) / (5 e v0) | Flores et al. 2011; Michaud et al. 2024, eq. 2 |

where v0 is the approach speed when contact began, which the Flores law keeps in memory. As v0 tends to 0, its damping
would grow without bound, so v0 is at least `approach_speed_floor`.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, safe_sqrt

SLOW = 0.01  # [m/s]
Speeds = tuple[Scalar, ...] | None  # approach speed of each contact when it began, 0 without contact [m/s]


class ContactForce(NamedTuple):
    """Force of a contact law at one indentation and rate."""

    total: Scalar  # force, elastic and viscous, at least 0 [N]
    elastic: Scalar  # elastic part of `total` [N]
    stiffness: Scalar  # dF/dd [N/m]
    damping: Scalar  # dF/d(dd/dt) [N s/m]
    energy: Scalar  # stored [J]


def _power(d: Scalar, exponent: Scalar | float) -> Scalar:
    """d^exponent for d >= 0, without transcendental functions for common exponents."""
    if isinstance(exponent, int | float):
        if exponent == 0:
            return jnp.where(d > 0, jnp.ones_like(d), 0.0)
        if exponent == 0.5:
            return safe_sqrt(d)
        if exponent == 1:
            return d
    positive = d > 0
    return jnp.where(positive, jnp.where(positive, d, 1.0) ** exponent, 0.0)


class ContactLaw(eqx.Module):
    """Base class of laws F = k d^p (1 + x dd/dt), with k in N/m^p. Pass p as a Python number if it does not vary: 1,
    1.5 and 2 then compile to a product or a square root.
    """

    contact_stiffness: Scalar = eqx.field(
        metadata=quantity("N/m^p", positive=True, words="contact stiffness, p the exponent")
    )  # k
    hertz_exponent: Scalar | float = eqx.field(
        default=1.5, kw_only=True, metadata=quantity("", at_least=1.0, words="exponent of the law")
    )  # p
    remembers_approach: ClassVar[bool] = False

    def slow_approach(self) -> float:
        """Approach speed up to which restitution does not matter [m/s]."""
        return SLOW

    @abstractmethod
    def damping_factor(self, approach_speed: Scalar | None) -> Scalar | None:
        """Damping factor x [s/m]; None if the law has no damping."""

    def no_contact_yet(self, like: Scalar, contacts: int) -> Speeds:
        """Memory of `contacts` contacts before any has begun, in the float type of `like`."""
        return (jnp.zeros_like(like),) * contacts if self.remembers_approach else None

    def elastic_ratio(self, indentation_ratio: Scalar) -> Scalar:
        """Ratio of the elastic forces at two indentations from the ratio of the indentations; 0 where that is < 0."""
        ratio = jnp.where(indentation_ratio > 0, indentation_ratio, 0.0)
        return ratio * _power(ratio, self.hertz_exponent - 1)

    def force(self, indentation: Scalar, rate: Scalar, approach_speed: Scalar | None = None) -> ContactForce:
        """Force and its derivatives at an indentation [m] and its rate [m/s].

        All are 0 where the indentation is at most 0. Laws with `remembers_approach` need `approach_speed` [m/s].
        """
        d = jnp.where(indentation > 0, indentation, 0.0)
        root = _power(d, self.hertz_exponent - 1)
        elastic = self.contact_stiffness * root * d
        slope = self.contact_stiffness * self.hertz_exponent * root
        energy = elastic * d / (self.hertz_exponent + 1)
        x = self.damping_factor(approach_speed)
        if x is None:
            return ContactForce(elastic, elastic, slope, jnp.zeros_like(elastic), energy)
        factor = 1 + x * rate
        pushes = factor > 0
        factor = jnp.where(pushes, factor, 0.0)
        return ContactForce(elastic * factor, elastic, slope * factor, jnp.where(pushes, elastic * x, 0.0), energy)


class Hertz(ContactLaw):
    """Elastic contact without dissipation: F = k d^p."""

    def damping_factor(self, approach_speed: Scalar | None) -> None:
        """No damping."""
        return


class HuntCrossley(ContactLaw):
    """F = k d^p (1 + 3/2 alpha dd/dt), with alpha in s/m (restitution of about 1 - alpha v0 in slow impacts)."""

    dissipation: Scalar = eqx.field(metadata=quantity("s/m", at_least=0))  # alpha

    def damping_factor(self, approach_speed: Scalar | None) -> Scalar:
        """3/2 alpha."""
        return 1.5 * self.dissipation


class Flores(ContactLaw):
    """F = k d^p (1 + 8 (1 - e) / (5 e) (dd/dt) / v0), v0 the approach speed when contact began, at least the floor."""

    # e: above 1, bounces would grow
    restitution: Scalar = eqx.field(
        metadata=quantity("", positive=True, at_most=1.0, words="coefficient of restitution")
    )
    approach_speed_floor: Scalar | float = eqx.field(
        default=SLOW, kw_only=True, metadata=quantity("m/s", positive=True)
    )
    remembers_approach: ClassVar[bool] = True

    def slow_approach(self) -> float:
        """The floor of v0: slower approaches get its damping, and their restitution is closer to 1."""
        return float(self.approach_speed_floor)

    def damping_factor(self, approach_speed: Scalar | None) -> Scalar:
        """8 (1 - e) / (5 e v0)."""
        if approach_speed is None:
            raise TypeError("the Flores law needs the approach speed at which contact began")
        v0 = jnp.maximum(approach_speed, self.approach_speed_floor)
        return 8 * (1 - self.restitution) / (5 * self.restitution * v0)
