"""Plants: synthetic knees with known springs, to test a twin. A function of a knee and random numbers makes one:

    def sticky(knee, random):
        spread = knee.near(random)
        return Plant(spread.with_effect(...))  # some other effect

    calibrate(trained, scene, kinds={"sticky": sticky})

Its springs may follow another law than the twin's: the true value is then the straight line nearest to them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from fitting.parameters import Parameters
from fitting.stiffening import Working, linear_tendons, stiffened, stiffening_tendons, working_of
from pftwin.base.errors import InputError
from pftwin.geometry.patch.polynomial import RectanglePatch
from pftwin.model.effects.friction import Friction
from pftwin.model.scene import Scene

_NEAR = 0.5  # share of the bounds, about their middle, within which springs lie that are not drawn from the priors
_SCATTER = 0.6  # SD of plants' nuisance parameters, uniform about the mean, as a share of their priors' SD
_STIFFENING = (0.0, 0.1)  # range of the share by which springs stiffen when stretched by a quarter of their length
_SLIP_SPEEDS = (2e-4, 5e-3)  # [m/s]
_COEFFICIENTS = (0.0, 0.1)  # of friction
_RESHAPED = (0.0, 1e-4)  # range of a trochlea's waves, rms over the whole patch [m]
_WAVES = 4  # their largest degree: two waves from edge to edge


@dataclass(frozen=True, eq=False)
class Knee:
    """The twin that is calibrated."""

    scene: Scene  # nominal, with nuisance effects added
    parameters: Parameters  # free parameters; the requested ones come first
    trials: tuple[Scene, ...] = ()  # the same in every trial, including this one; by default one trial
    lacking: tuple[Scene, Parameters] | None = None  # with nuisance added, if the twin itself is taken as exact

    @cached_property
    def working(self) -> dict[str, Working]:
        """Working lengths of its linear tendons, by name; simulated once for all plants."""
        return working_of(self.trials or [self.scene], linear_tendons(self.scene))

    def drawn(self, random: np.random.Generator) -> Scene:
        """A scene with parameters drawn from the priors."""
        return self.parameters.apply(self.scene, self.parameters.scattered(1, random)[0])

    def near(self, random: np.random.Generator) -> Scene:
        """A scene whose springs lie near the middle of their bounds, and whose parameters with a prior, such as
        nuisance, are uniform with a smaller spread than the prior's."""
        scene, p = self.lacking or (self.scene, self.parameters)
        middle, half = 0.5 * (p.lower + p.upper), 0.5 * (p.upper - p.lower)
        theta = middle + _NEAR * half * random.uniform(-1.0, 1.0, len(p))
        for i, item in enumerate(p.items):
            if item.prior is not None:
                mean, sd = item.prior
                most = np.sqrt(3.0) * _SCATTER * sd
                theta[i] = np.clip(mean + random.uniform(-most, most), item.lower, item.upper)
        return p.apply(scene, theta)


class Plant(NamedTuple):
    """A knee to be recorded."""

    scene: Scene
    curved: tuple[str, ...] = ()  # names of tendons whose springs are not linear

    @staticmethod
    def of(scene: Scene) -> Plant:
        """A plant whose stiffening tendons, if any, are marked as curved."""
        return Plant(scene, stiffening_tendons(scene))


Maker = Callable[[Knee, np.random.Generator], Plant]


def twin(knee: Knee, random: np.random.Generator) -> Plant:
    """The twin itself, with parameters drawn from the priors."""
    return Plant.of(knee.drawn(random))


def misplaced(knee: Knee, random: np.random.Generator) -> Plant:
    """Attachments, friction and damping distributed otherwise than in the priors."""
    return Plant.of(knee.near(random))


def sliding(knee: Knee, random: np.random.Generator) -> Plant:
    """As `misplaced`, with another friction coefficient and another slip speed than the twin's.

    Raises:
        InputError: no contact, or one that cannot have friction.
    """
    scene = knee.near(random)
    contact = scene.contact
    if contact is None:
        raise InputError("friction without a contact", where="plants", expected="others than 'sliding'")
    coefficient, slip_speed = random.uniform(*_COEFFICIENTS), np.exp(random.uniform(*np.log(_SLIP_SPEEDS)))
    rough = Friction(*(jnp.asarray(x, float) for x in (coefficient, slip_speed)))
    return Plant.of(scene.with_effect(contact.with_friction(rough)))


def stiffening(knee: Knee, random: np.random.Generator) -> Plant:
    """As `misplaced`, with tendons that stiffen by a share uniform between 0 and a tenth."""
    scene = knee.near(random)
    if linear_tendons(scene):  # of a twin whose tendons do not stiffen
        scene = stiffened(scene, knee.working, dict.fromkeys(knee.working, 0.0))
    for name in stiffening_tendons(scene):
        scene = scene.set(f"{name}.stiffening", random.uniform(*_STIFFENING))
    return Plant.of(scene)


def reshaped(knee: Knee, random: np.random.Generator) -> Plant:
    """As `misplaced`, on another trochlea: the twin's with smooth waves of at most a tenth of a millimetre (rms).

    Waves exclude shifts and rotations of the whole trochlea.

    Raises:
        InputError: the button touches no fitted patch.
    """
    scene = knee.near(random)
    contact = scene.contact
    surface = None if contact is None else contact.fitted_surface()
    if contact is None or not isinstance(surface, RectanglePatch):
        raise InputError("no patch to reshape", where="plants", expected="others than 'reshaped', or a fitted surface")
    order = np.arange(_WAVES + 1)
    together = np.add.outer(order, order)
    series = random.standard_normal(together.shape) * ((together >= 2) & (together <= _WAVES))
    mean_square = np.sum(series**2 / np.multiply.outer(2 * order + 1, 2 * order + 1))  # of Legendre polynomials
    waves = random.uniform(*_RESHAPED) / np.sqrt(mean_square) * series
    return Plant.of(scene.with_effect(contact.with_fitted_surface(surface.with_waves(waves))))


PLANTS: dict[str, Maker] = {
    "twin": twin,
    "misplaced": misplaced,
    "sliding": sliding,
    "stiffening": stiffening,
}
BY_NAME = {"reshaped": reshaped}  # not by default: they need a contact with a fitted patch
