"""The set-up that a posterior is trained for, and its recordings expressed relative to the nominal knee's motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.evaluation import Prediction
from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.objective import Objective
from fitting.parameters import Parameters
from fitting.trials import free_in_trials, objective_of, trial_names
from pftwin.base.arrays import Floats, Rows
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

_MISSING = 0.1  # largest share of a column's frames that may be missing and are interpolated


class SetUp(NamedTuple):
    """The set-up that a posterior is trained for."""

    scene_name: str
    free: tuple[str, ...]
    bounds: dict[str, tuple[float, float]]
    priors: dict[str, tuple[float, float]]  # without those of nuisance
    nuisance: Nuisance
    channels: tuple[str, ...]
    noise: dict[str, Any] | None  # by channel, if stated: standard deviations and covariances
    springs: dict[str, str]
    frames: tuple[int, ...]  # number of frames of each trial
    varies: dict[str, float]  # standard deviation between trials, by name

    @staticmethod
    def of(problem: Problem, nuisance: Nuisance, springs: Mapping[str, str]) -> SetUp:
        """The set-up of a problem whose posterior is trained."""
        asked, scenes = problem.parameters.items[: problem.parameters.asked], problem.evaluator.scenes
        return SetUp(
            " + ".join(trial_names(scenes)),
            tuple(p.name for p in asked),
            {p.name: (p.lower, p.upper) for p in asked},
            {p.name: p.prior for p in asked if p.prior is not None},
            nuisance,
            problem.objective.channels,
            None if (noise := problem.objective.stated_noise) is None else dict(noise),
            dict(springs),
            tuple(scene.motion.times.size for scene in scenes),
            problem.parameters.varies,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for files."""
        return {**self._asdict(), "nuisance": asdict(self.nuisance)}

    @staticmethod
    def from_dict(facts: Mapping[str, Any]) -> SetUp:
        """The set-up from plain values. Raises KeyError, TypeError or IndexError if they are none."""
        held: dict[str, Any] = {key: facts[key] for key in SetUp._fields if key != "varies"}
        held |= {key: tuple(facts[key]) for key in ("free", "channels", "frames")}
        held |= {key: {n: (v[0], v[1]) for n, v in facts[key].items()} for key in ("bounds", "priors")}
        held |= {"nuisance": Nuisance(**facts["nuisance"]), "varies": facts.get("varies", {})}  # older files have none
        return SetUp(**held)

    def parameters(self, scenes: Sequence[Scene]) -> tuple[list[Scene], list[Parameters]]:
        """The scenes with nuisance effects added, and the free parameters of each."""
        return free_in_trials(scenes, self.free, self.bounds, self.priors, self.nuisance, self.varies)

    def check_frames(self, scenes: Sequence[Scene], where: str) -> None:
        """Raises InputError for another number of trials or frames."""
        if (found := tuple(scene.motion.times.size for scene in scenes)) != self.frames:
            expected = f"{comma_list(self.frames)}, as it was set up for"
            raise InputError(f"{comma_list(found)} frames", where=where, expected=expected)

    def objective(self, scenes: Sequence[Scene], measured: Sequence[Measured]) -> Objective:
        """The measurements of such scenes. Raises InputError for another number of frames, a channel that was not
        measured, or channels that differ from those in training."""
        self.check_frames(scenes, measured[0].source)
        target = objective_of(scenes, measured, "likelihood", self.channels, self.noise, "linear", self.springs)
        if target.channels != self.channels:
            found = f"{', '.join(target.channels)} measured"
            raise InputError(found, where=target.source, expected=f"{', '.join(self.channels)}, as in training")
        return target


def from_nominal(problem: Problem, substeps: int, others: Floats) -> tuple[Objective, Prediction]:
    """The objective with the nominal knee's motion in place of the measurements, for the measured channels and frames;
    and motions of other parameters (N, p), simulated in the same call. Raises InputError if the nominal knee fails."""
    prediction = problem.evaluator.values(np.concatenate([problem.parameters.nominal[None], others]), substeps)
    if not prediction.usable[0]:
        raise InputError("the nominal knee finds no equilibrium or no finite motion", where=problem.scene.name)
    target, present = problem.objective, np.zeros_like(problem.objective.present)
    for rows in target.frames:
        present[rows] = target.present[rows].any(axis=0)
    held = replace(target, measured=prediction.values[0], present=present)
    return held, Prediction(prediction.values[1:], None, prediction.usable[1:])


def relative_measurements(problem: Problem, held: Objective, wanted: NDArray[np.bool_]) -> Rows:
    """Measurements (n, m) relative to the nominal knee's motion, interpolated over gaps; zero where not `wanted`.
    Raises InputError if too much is missing."""
    target = problem.objective
    measured = -target.residuals(held.measured[None])[0]
    out = np.zeros(measured.shape, np.float32)
    for rows in target.frames:
        at = np.arange(len(measured[rows]))
        for column in np.flatnonzero(wanted[rows].any(axis=0)):
            known = target.present[rows, column]
            if (share := 1 - known.mean()) > _MISSING:
                found = f"{share:.0%} of a channel's frames are missing"
                raise InputError(found, where=target.source, expected=f"at most {_MISSING:.0%}: gaps are bridged")
            out[rows, column] = np.interp(at, at[known], measured[rows, column][known])
    return out


def refuse_weights(measured: Sequence[Measured]) -> None:
    """Raises InputError if frames have weights: a set-up's recordings would all need the same."""
    for data in measured:
        if data.weights is not None:
            remedy = "leave out the weights, or use fit_tendons, which fits a single recording"
            raise InputError(
                "frames have weights", where=data.source, expected="measurements without weights", remedy=remedy
            )


def widened_in_words(free: Sequence[str], factors: Sequence[float]) -> str:
    """By how much intervals of the requested parameters were widened, to end a sentence; empty if by nothing."""
    more = ", ".join(f"{name} {times:.2g}" for name, times in zip(free, factors, strict=False) if times > 1)
    return f"; widened by a calibration: {more} times" if more else ""


def comma_list(numbers: Sequence[int]) -> str:
    """The numbers, separated by commas."""
    return ", ".join(str(n) for n in numbers)
