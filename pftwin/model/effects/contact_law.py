"""Normal contact laws, free of geometry: from indentation and its rate to a force, its slopes and its energy.

Each law is F = k d^p (1 + x dd/dt), never negative. They differ in the damping x:

| law | x | source |
|---|---|---|
| Hertz | 0 | Hertz 1882 |
| HuntCrossley | 3/2 alpha | Hunt & Crossley 1975 |
| Flores | 8 (1 - e) / (5 e v0) | Flores et al. 2011; Michaud et al. 2024, eq. 2 |

where v0 is the approach speed at the moment contact began: the Flores law remembers. As v0 tends to 0 (slow touch) its
damping would grow without bound, so v0 is held above `approach_speed_floor`.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, safe_sqrt

SLOW = 0.01  # [m/s]
Speeds = tuple[Scalar, ...] | None  # each contact's approach speed when it began, 0 while apart [m/s]


class ContactForce(NamedTuple):
    """A contact law's answer at one indentation and rate."""

    total: Scalar  # force, elastic and viscous, at least 0 [N]
    elastic: Scalar  # its elastic part [N]
    stiffness: Scalar  # dF/dd [N/m]
    damping: Scalar  # dF/d(dd/dt) [N s/m]
    energy: Scalar  # stored [J]


def _power(d: Scalar, exponent: Scalar | float) -> Scalar:
    """d^exponent for d >= 0; the common exponents avoid the transcendental functions."""
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
    """A law F = k d^p (1 + x dd/dt) with k in N/m^p. Give p as a Python number where it is not to be varied: 1, 1.5
    and 2 then compile to a product or a square root.
    """

    contact_stiffness: Scalar = eqx.field(
        metadata=quantity("N/m^p", positive=True, words="contact stiffness, p the exponent")
    )  # k
    hertz_exponent: Scalar | float = eqx.field(
        default=1.5, kw_only=True, metadata=quantity("", at_least=1.0, words="exponent of the law")
    )  # p
    remembers_approach: ClassVar[bool] = False

    def slow_approach(self) -> float:
        """Up to this speed an approach is too slow for its restitution to matter [m/s]."""
        return SLOW

    @abstractmethod
    def damping_factor(self, approach_speed: Scalar | None) -> Scalar | None:
        """The factor x [s/m]; None where the law has no damping."""

    def no_contact_yet(self, like: Scalar, contacts: int) -> Speeds:
        """The memory before anything has touched, in the float type of `like`."""
        return (jnp.zeros_like(like),) * contacts if self.remembers_approach else None

    def elastic_ratio(self, indentation_ratio: Scalar) -> Scalar:
        """The elastic force at an indentation by that at another one, from their ratio; 0 where that is negative."""
        ratio = jnp.where(indentation_ratio > 0, indentation_ratio, 0.0)
        return ratio * _power(ratio, self.hertz_exponent - 1)

    def force(self, indentation: Scalar, rate: Scalar, approach_speed: Scalar | None = None) -> ContactForce:
        """Force and slopes at an indentation [m] and its rate [m/s].

        Where indentation is at most 0 all are 0. `approach_speed` [m/s] is needed by laws that remember it.
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
    """Elastic contact without loss: F = k d^p."""

    def damping_factor(self, approach_speed: Scalar | None) -> None:
        """No damping."""
        return


class HuntCrossley(ContactLaw):
    """F = k d^p (1 + 3/2 alpha dd/dt), with alpha in s/m (restitution about 1 - alpha v0 for slow impacts)."""

    dissipation: Scalar = eqx.field(metadata=quantity("s/m", at_least=0))  # alpha

    def damping_factor(self, approach_speed: Scalar | None) -> Scalar:
        """3/2 alpha."""
        return 1.5 * self.dissipation


class Flores(ContactLaw):
    """F = k d^p (1 + 8 (1 - e) / (5 e) (dd/dt) / v0), v0 the approach speed when contact began, at least the floor."""

    # e: above 1 bounces would grow
    restitution: Scalar = eqx.field(
        metadata=quantity("", positive=True, at_most=1.0, words="coefficient of restitution")
    )
    approach_speed_floor: Scalar | float = eqx.field(
        default=SLOW, kw_only=True, metadata=quantity("m/s", positive=True)
    )
    remembers_approach: ClassVar[bool] = True

    def slow_approach(self) -> float:
        """The floor: below it the damping is that of the floor, and the restitution nearer to 1."""
        return float(self.approach_speed_floor)

    def damping_factor(self, approach_speed: Scalar | None) -> Scalar:
        """8 (1 - e) / (5 e v0)."""
        if approach_speed is None:
            raise TypeError("the Flores law needs the approach speed at which contact began")
        v0 = jnp.maximum(approach_speed, self.approach_speed_floor)
        return 8 * (1 - self.restitution) / (5 * self.restitution * v0)
