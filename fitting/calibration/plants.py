"""Plants: synthetic knees with known springs, to test a twin; their motion, and the springs that the twin should find.

A function of a knee and random numbers makes one:

    def sticky(knee, random):
        scene = knee.near(random)
        return Plant(scene.with_effect(...))  # some other effect

    calibrate(trained, scene, kinds={"sticky": sticky})

Its springs may follow another law than the twin's: the true value is then the straight line nearest to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fitting.demo.straight_springs import straight_line
from fitting.parameters import Parameters
from fitting.stiffening import Working, linear_tendons, stiffened, stiffening_tendons, working_of
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.dynamics.batch.simulate_batch import simulate_batch
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import Observation
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
_LINE_PATHS = (("stiffness",), ("slack_length",))  # parameters that the line nearest to a spring determines
_STEP = 5e-4  # time step of plants [s], whose integrator differs from a fit's
_PREFIX = "plant "  # prefix of these variables' names, to avoid those of a batch


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
        nuisance, are uniform with a smaller standard deviation than the prior's."""
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


PLANTS: dict[str, Maker] = {"twin": twin, "misplaced": misplaced, "sliding": sliding, "stiffening": stiffening}
BY_NAME = {"reshaped": reshaped}  # not by default: they need a contact with a fitted patch


class PlantMotion(NamedTuple):
    """A plant's motion and forces, without noise."""

    position: Floats  # (n, 3) of the patella in the femur [m]
    quaternion: Floats  # (n, 4)
    reported: dict[str, dict[str, Floats]]  # (n,) each: scalar observables of effects, by effect

    @property
    def forces(self) -> dict[str, Floats]:
        """Forces (n,) of contact and tendons by name [N]."""
        found = {name: report.get("force", report.get("tension")) for name, report in self.reported.items()}
        return {name: force for name, force in found.items() if force is not None}


def simulate_plants(plants: Sequence[Plant]) -> list[PlantMotion | None]:
    """Motion of each plant; None if it could not be simulated. Raises InputError for scenes that fail `check`."""
    found = simulate_batch(
        [plant.scene for plant in plants],
        integrator=BDF2(),
        dt=_STEP,
        outcome=_outputs,
        trajectories=False,
        energy_budget=False,
        estimate=False,
        care=False,
    )
    failed = np.asarray(found["failed"])
    names = [str(name) for name in found.data_vars if str(name).startswith(_PREFIX)]
    arrays = {name.removeprefix(_PREFIX): np.asarray(found[name]) for name in names}

    def motion_of(i: int) -> PlantMotion:
        reported: dict[str, dict[str, Floats]] = {}
        for name, value in arrays.items():
            owner, _, key = name.rpartition(".")
            if owner:
                reported.setdefault(owner, {})[key] = value[i]
        return PlantMotion(arrays["position"][i], arrays["quaternion"][i], reported)

    return [None if failed[i] else motion_of(i) for i in range(len(plants))]


def _outputs(scene: Scene, observation: Observation) -> dict[str, Array]:
    patella = observation.patella
    found: dict[str, Any] = {"position": patella.position.array(), "quaternion": patella.orientation.array()}
    for name, report in observation.effects.items():
        found |= {f"{name}.{key}": value for key, value in report.items() if jnp.ndim(value) == 1}
    return {f"{_PREFIX}{name}": value for name, value in found.items()}


def check_truth(plant: Plant, parameters: Parameters) -> None:
    """Raises InputError for requested parameters that a plant does not have: the slack length, as a strain or force,
    of a tendon that follows another law, or a tied parameter of one."""
    for item in parameters.items[: parameters.asked]:
        if item.place.owner in plant.curved and item.place.meaning != "value":
            expected = "stiffness and slack length themselves of a tendon that follows another law"
            raise InputError(f"{item.name} has no true value in this plant", where="kinds", expected=expected)
        if {t.owner for t in item.place.tied} & {*plant.curved}:
            expected = "no tied numbers of tendons that follow another law"
            raise InputError(f"{item.name} has no true value in this plant", where="kinds", expected=expected)


def truth_of(
    plant: Plant, motions: Sequence[PlantMotion], parameters: Parameters, differing: Sequence[Plant] | None = None
) -> Floats:
    """True values of the requested parameters (d,): for a tendon that follows another law, those of the straight line
    nearest to its spring over the lengths that occurred in all trials; for what differs between trials, the mean.

    The plant and parameters are those of the first trial, without differences; `motions` are those of all trials,
    and `differing` the plant in each. Raises InputError for a tendon that is never stretched.
    """
    found = []
    for item in parameters.items[: parameters.asked]:
        owner, path = item.place.owner, item.place.path
        if owner not in plant.curved or path not in _LINE_PATHS:
            found.append(float(item.place.read(plant.scene)))
            continue
        mean: Any = plant.scene.effect(owner)
        tendons: list[Any] = [own.scene.effect(owner) for own in differing or [plant] * len(motions)]
        longer = [float(tendon.slack_length - mean.slack_length) for tendon in tendons]
        lengths = np.concatenate([one.reported[owner]["length"] - by for one, by in zip(motions, longer, strict=True)])
        line = straight_line(lengths, np.maximum(np.asarray(mean.held_tension(jnp.asarray(lengths))), 0.0))
        found.append(line.stiffness if path == ("stiffness",) else line.slack_length)
    return np.array(found)
