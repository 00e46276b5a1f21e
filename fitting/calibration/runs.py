"""Simulates plants in one batch, and computes the spring parameters that the twin should find."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fitting.calibration.plants import Plant
from fitting.demo.straight_springs import straight_line
from fitting.parameters import Parameters
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.dynamics.batch.simulate_batch import simulate_batch
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import Observation
from pftwin.model.scene import Scene

_LINE_PATHS = (("stiffness",), ("slack_length",))  # parameters that the line nearest to a spring determines
_STEP = 5e-4  # time step of plants [s], whose integrator differs from a fit's


class Seen(NamedTuple):
    """A plant's motion and forces, without noise."""

    position: Floats  # (n, 3) of the patella in the femur [m]
    quaternion: Floats  # (n, 4)
    reported: dict[str, dict[str, Floats]]  # (n,) each: scalar observables of effects, by effect

    @property
    def forces(self) -> dict[str, Floats]:
        """Forces (n,) of contact and tendons by name [N]."""
        told = {name: seen.get("force", seen.get("tension")) for name, seen in self.reported.items()}
        return {name: force for name, force in told.items() if force is not None}


def run(plants: Sequence[Plant]) -> list[Seen | None]:
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
    kept = {name.removeprefix(_PREFIX): np.asarray(found[name]) for name in names}

    def of(i: int) -> Seen:
        reported: dict[str, dict[str, Floats]] = {}
        for name, value in kept.items():
            owner, _, key = name.rpartition(".")
            if owner:
                reported.setdefault(owner, {})[key] = value[i]
        return Seen(kept["position"][i], kept["quaternion"][i], reported)

    return [None if failed[i] else of(i) for i in range(len(plants))]


_PREFIX = "plant "  # prefix of these variables' names, to avoid those of a batch


def _outputs(scene: Scene, seen: Observation) -> dict[str, Array]:
    patella = seen.patella
    found: dict[str, Any] = {"position": patella.position.array(), "quaternion": patella.orientation.array()}
    for name, report in seen.effects.items():
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
    plant: Plant, seen: Sequence[Seen], parameters: Parameters, differing: Sequence[Plant] | None = None
) -> Floats:
    """True values of the requested parameters (d,): for a tendon that follows another law, those of the straight line
    nearest to its spring over the lengths that occurred in all trials; for what differs between trials, the mean.

    The plant and parameters are those of the first trial, without differences; `seen` are the motions of all trials,
    and `differing` the plant in each. Raises InputError for a tendon that is never stretched.
    """
    found = []
    for item in parameters.items[: parameters.asked]:
        owner, path = item.place.owner, item.place.path
        if owner not in plant.curved or path not in _LINE_PATHS:
            found.append(float(item.place.read(plant.scene)))
            continue
        mean: Any = plant.scene.effect(owner)
        tendons: list[Any] = [own.scene.effect(owner) for own in differing or [plant] * len(seen)]
        longer = [float(tendon.slack_length - mean.slack_length) for tendon in tendons]
        lengths = np.concatenate([one.reported[owner]["length"] - by for one, by in zip(seen, longer, strict=True)])
        line = straight_line(lengths, np.maximum(np.asarray(mean.held_tension(jnp.asarray(lengths))), 0.0))
        found.append(line.stiffness if path == ("stiffness",) else line.slack_length)
    return np.array(found)
