"""Knees with known springs that a twin is tried on. A plant is made by a function of a knee and random numbers:

    def sticky(knee, random):
        spread = knee.near(random)
        return Plant(spread.with_effect(...))

    calibrate(trained, scene, plants={"sticky": sticky})

Its springs may follow another law than the twin's: then the truth is the straight line nearest to them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from fitting.parameters import Parameters
from pftwin.base.errors import InputError
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.line_elements import TOE
from pftwin.model.effects.tendon import DampedLine, SpringForce
from pftwin.model.scene import Scene

_NEAR = 0.5  # of the bounds about their middle: where springs of plants lie that are not drawn from the priors
_SCATTER = 0.6  # of the priors' deviations: by as much plants' nuisance is off, evenly to either side of the mean
_STIFFENING = (0.0, 0.1)  # share by which springs are stiffer when stretched by a quarter of their length
_SLIP_SPEEDS = (2e-4, 5e-3)  # [m/s]
_COEFFICIENTS = (0.0, 0.1)  # of friction


class Knee(NamedTuple):
    """The twin that a posterior was trained for."""

    scene: Scene  # the nominal one, with whatever is fitted in it
    parameters: Parameters  # what is free in it; the first are asked for

    def drawn(self, random: np.random.Generator) -> Scene:
        """One whose parameters come from the priors."""
        return self.parameters.apply(self.scene, self.parameters.scattered(1, random)[0])

    def near(self, random: np.random.Generator) -> Scene:
        """One whose springs lie about the middle of their bounds, and whose nuisance is spread less than its priors,
        and evenly."""
        p, d = self.parameters, self.parameters.asked
        middle, half = 0.5 * (p.lower + p.upper), 0.5 * (p.upper - p.lower)
        theta = middle + _NEAR * half * random.uniform(-1.0, 1.0, len(p))
        for i, item in enumerate(p.items[d:], d):
            if item.prior is not None:
                mean, sd = item.prior
                most = np.sqrt(3.0) * _SCATTER * sd
                theta[i] = np.clip(mean + random.uniform(-most, most), item.lower, item.upper)
        return p.apply(self.scene, theta)


class Plant(NamedTuple):
    """A knee that is recorded."""

    scene: Scene
    curved: tuple[str, ...] = ()  # names of tendons that follow another law than the twin's


Maker = Callable[[Knee, np.random.Generator], Plant]


class StiffeningSpring(NamedTuple):
    """F = K s (1 + e s / (L0 / 4))."""

    stiffness: Scalar  # K [N/m]
    more: Scalar  # 4 e / L0 [1/m]

    def at(self, stretch: Scalar) -> SpringForce:
        """At a stretch [m]."""
        k, m, s = self.stiffness, self.more, stretch
        return SpringForce(k * s * (1 + m * s), k * (1 + 2 * m * s), k * s * s * (0.5 + m * s / 3))


class StiffeningTendon(DampedLine):
    """A tendon that is stiffer the more it is stretched."""

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True))  # K, where it begins to pull
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True))  # L0
    damping: Scalar = eqx.field(metadata=quantity("N s/m", at_least=0))  # c
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    stiffening: Scalar = eqx.field(metadata=quantity("", at_least=0))  # e, when stretched by a quarter of its length
    body: str = eqx.field(static=True)

    @property
    def law(self) -> StiffeningSpring:
        """Its spring's."""
        return StiffeningSpring(self.stiffness, 4 * self.stiffening / self.slack_length)


def twin(knee: Knee, random: np.random.Generator) -> Plant:
    """The twin itself, with parameters from the priors."""
    return Plant(knee.drawn(random))


def misplaced(knee: Knee, random: np.random.Generator) -> Plant:
    """Attachments, friction and damping off otherwise than the priors say."""
    return Plant(knee.near(random))


def sliding(knee: Knee, random: np.random.Generator) -> Plant:
    """As `misplaced`, with friction of any coefficient and another slip speed than the twin's.

    Raises:
        InputError: no contact, or one that cannot have friction.
    """
    scene = knee.near(random)
    contact = scene.contact
    if contact is None:
        raise InputError("friction without a contact", where="plants", expected="others than 'sliding'")
    coefficient, slip_speed = random.uniform(*_COEFFICIENTS), np.exp(random.uniform(*np.log(_SLIP_SPEEDS)))
    rough = Friction(*(jnp.asarray(x, float) for x in (coefficient, slip_speed)))
    return Plant(scene.with_effect(contact.with_friction(rough)))


def stiffening(knee: Knee, random: np.random.Generator) -> Plant:
    """As `misplaced`, with linear tendons that stiffen."""
    scene = knee.near(random)
    linear: list[Any] = [e for e in scene.effects if any(change.label == TOE for change in e.elaborations())]
    for e in linear:
        share = jnp.asarray(random.uniform(*_STIFFENING), float)
        numbers = e.stiffness, e.slack_length, e.damping, e.insertion, e.origin, share
        scene = scene.with_effect(StiffeningTendon(*numbers, e.body, name=e.name))
    return Plant(scene, tuple(e.name for e in linear))


PLANTS: dict[str, Maker] = {
    "twin": twin,
    "misplaced": misplaced,
    "sliding": sliding,
    "stiffening": stiffening,
}
