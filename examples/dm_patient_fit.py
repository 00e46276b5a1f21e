"""The DM recording as a patient: fits of two tendons, and comparison of their forces with recorded ones not used."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dm_effective import PATELLAR_TENDON, QUADRICEPS, Course, courses, patient, reference
from dm_knee import Knee, build, pose_errors, recorded_center
from numpy.typing import NDArray

import fitting
import pftwin
from fitting.estimate import Estimate
from fitting.evaluation import Evaluator
from fitting.identifiability import ExperimentPlan
from fitting.parameters import free_parameters
from fitting.uncertainty import NORMAL_95
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene
from pftwin.results.result import Result

Floats = NDArray[np.float64]

TENDONS = (QUADRICEPS, PATELLAR_TENDON)
FREE = ("K1", "L1", "K2", "L2")
HEIGHT = "quadriceps.origin.z"  # anterior position of the effective quadriceps' origin
SOURCE = "the DM recording (simulated by OpenSim JAM)"


class Fit(NamedTuple):
    """Definition of a fit."""

    use: tuple[str, ...]  # measured channels to fit
    free: tuple[str, ...] = FREE  # free parameters


FITS = {
    "positions": Fit(("position",)),
    "positions, orientations": Fit(("position", "orientation")),
    "positions, one force": Fit(("position", QUADRICEPS)),
    "positions, one force; origin free": Fit(("position", QUADRICEPS), (*FREE, HEIGHT)),
}


@dataclass(frozen=True)
class Patient:
    """The scene to fit, the measurements, and reference values for comparison."""

    knee: Knee
    courses: dict[str, Course]
    scene: Scene
    measured: Measured  # poses, and the quadriceps' recorded tension, which only some fits use
    reference: dict[str, float]  # K1, L1, K2, L2 from the recorded tensions; only for comparison

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Bounds of the fit: two orders of magnitude for stiffness, wide for slack length, 30 mm about the height."""
        first = {name: self.courses[name].length[0] for name in TENDONS}
        height = float(self.courses[QUADRICEPS].origin[2])
        return {
            "K1": (300.0, 30e3),
            "L1": (0.4 * first[QUADRICEPS], 1.4 * first[QUADRICEPS]),
            "K2": (10e3, 1e6),
            "L2": (0.95 * first[PATELLAR_TENDON], 1.02 * first[PATELLAR_TENDON]),
            HEIGHT: (height - 0.03, height + 0.03),
        }


class Agreement(NamedTuple):
    """Agreement of a fitted tension with the recorded one, over the frames."""

    correlation: float
    rms: float  # of the difference [N]
    ratio: float  # of the sums, fitted over recorded


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit, and the simulation of the fitted scene."""

    estimate: Estimate
    result: Result
    offset: Floats  # (n, 3) of the sphere's centre from the recorded one: proximal, lateral, anterior [m]
    angles: Floats  # (n, 3) rotation vector from recorded to simulated, x, y, z of the data's button [deg]
    recorded: dict[str, Floats]  # (n,) tension of each tendon [N]

    @property
    def mean_distance(self) -> float:
        """Mean distance of the sphere's centre from its recorded position [m]."""
        return float(np.linalg.norm(self.offset, axis=1).mean())

    def tension(self, name: str) -> Floats:
        """Returns the simulated tension of a tendon (n,) [N]."""
        return np.asarray(self.result.effects[name]["tension"])

    def agreement(self, name: str) -> Agreement:
        """Compares a tendon's tension with the recorded one."""
        here, there = self.tension(name), self.recorded[name]
        off = float(np.sqrt(np.mean((here - there) ** 2)))
        return Agreement(float(np.corrcoef(here, there)[0, 1]), off, float(here.sum() / there.sum()))


def prepare(folder: Path) -> Patient:
    """Builds the patient from the files of a folder.

    Raises:
        InputError: the folder is missing, or its files are not usable.
    """
    knee = build(folder)
    found = courses(knee)
    measured = Measured(
        knee.patella.times,
        recorded_center(knee),
        knee.patella.quaternions,
        femoral_spring_force=knee.tensions.column(QUADRICEPS),
        synthetic=True,
        source=SOURCE,
    )
    return Patient(knee, found, patient(knee, found), measured, reference(knee, found))


def fit(case: Patient, what: Fit, **options: Any) -> Estimate:
    """Fits the free parameters; options, such as `priors`, are those of `fitting.fit_tendons`."""
    bounds = {name: case.bounds[name] for name in what.free}
    return fitting.fit_tendons(case.scene, case.measured, free=what.free, bounds=bounds, use=what.use, **options)


def judge(case: Patient, estimate: Estimate, *, dt: float = 1e-3) -> Outcome:
    """Simulates the fitted scene, and compares motion and tensions with the recorded ones."""
    result = pftwin.simulate(estimate.scene, dt=dt)
    offset, angles = pose_errors(case.knee, result)
    return Outcome(estimate, result, offset, angles, {n: case.knee.tensions.column(n) for n in TENDONS})


def tension_bands(case: Patient, estimate: Estimate) -> dict[str, tuple[Floats, Floats]]:
    """Computes tensions with 95 % bands, by linear propagation of the estimate's covariance.

    Returns:
        By tendon: its tension and half the width of its band, (n,) [N] each.
    """
    limits: Any = {name: case.bounds[name] for name in estimate.names}
    evaluator = Evaluator(case.scene, free_parameters(case.scene, estimate.names, limits), TENDONS)
    evaluator.prepare(None)
    seen = evaluator.with_slopes(estimate.values[None], evaluator.fine)
    assert seen.slopes is not None
    variance = np.einsum("ncp,pq,ncq->nc", seen.slopes[0], estimate.covariance, seen.slopes[0])
    half = NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))
    return {name: (seen.values[0, :, i], half[:, i]) for i, name in enumerate(TENDONS)}


def ideal(case: Patient, estimate: Estimate) -> ExperimentPlan:
    """Plans the experiment for a correct model: the precision that positions with 0.2 mm error would give."""
    return fitting.plan_experiment(estimate.apply(case.scene), free=FREE, candidates=[QUADRICEPS])
