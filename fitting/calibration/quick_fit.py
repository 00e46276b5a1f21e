"""`QuickFit`: a search for each recording that `calibrate` can test in place of a trained posterior."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fitting.estimate import Estimate
from fitting.fit import METHODS, SIMULATIONS, SPRING_PARAMETERS, fit_tendons
from fitting.inference.infer import DRAWS
from fitting.measured_channels import force_fields, measured_channels
from fitting.methods.problem import Problem
from fitting.metric import StatedNoise
from fitting.nuisance import Nuisance
from fitting.objective import SPRINGS
from fitting.parameters import Bounds
from fitting.programs import POSITION
from fitting.set_up import SetUp, comma_list, refuse_weights, widened_in_words
from fitting.trials import free_in_trials, objective_of, trials_of
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import read_json, restored_numbers, write_json_file
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

FORMAT = "pftwin calibrated fit 1"
_SAME = 1e-6  # largest difference of nominal values, relative or in SI units


@dataclass(frozen=True)
class QuickFit:
    """`fit_tendons` for every recording of a set-up; made by `QuickFit.of`."""

    set_up: SetUp
    method: str
    measured: tuple[tuple[str, ...], ...]  # channels that were measured in each trial of the first recording
    nominal: tuple[float, ...]  # values of the free and nuisance parameters in the first recording's scene
    widened: tuple[float, ...] = ()  # factors (d,) by which intervals are widened after a calibration
    plants: Mapping[str, int] = field(default_factory=dict)  # number of plants of that calibration, by kind

    @staticmethod
    def of(
        scene: Scene | Sequence[Scene],
        measured: Measured | Sequence[Measured | None] | None = None,
        *,
        method: str = "least_squares",
        free: Sequence[str] = SPRING_PARAMETERS,
        bounds: Bounds = 0.3,
        priors: Mapping[str, tuple[float, float]] | None = None,
        nuisance: str | Nuisance | None = None,
        varies: Mapping[str, float] | None = None,
        use: str | Sequence[str] = POSITION,
        noise: StatedNoise | None = None,
        springs: Mapping[str, str] = SPRINGS,
    ) -> QuickFit:
        """Arguments are those of `fit_tendons` for a first recording, which defines the set-up.

        Raises:
            InputError: a method that is not a search; frames with weights; as `fit_tendons`.
        """
        if method not in METHODS:
            found = "simulations would be learned from anew for each plant" if method == SIMULATIONS else repr(method)
            remedy = "for simulations a posterior that is trained once: fitting.train_posterior"
            raise InputError(found, where="method", expected=f"one of: {', '.join(METHODS)}", remedy=remedy)
        extra = Nuisance.of(nuisance)
        extra.refuse_sensors(f"method {method!r}")
        nominal, data = trials_of(scene, measured)
        refuse_weights(data)
        scenes, parameters = free_in_trials(nominal, free, bounds, priors, extra, varies)
        target = objective_of(scenes, data, "likelihood", use, noise, "linear", springs)
        there = [measured_channels(one, own, springs)[0] for one, own in zip(scenes, data, strict=True)]
        channels = tuple(tuple(name for name in target.channels if name in each) for each in there)
        set_up, nominal = SetUp.of(Problem.of(scenes, parameters, target), extra, springs), parameters[0].nominal
        return QuickFit(set_up, method, channels, tuple(nominal.tolist()))

    def estimate(
        self,
        scene: Scene | Sequence[Scene],
        measured: Measured | Sequence[Measured | None] | None = None,
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
        **more: Any,
    ) -> Estimate:
        """As `fit_tendons`, with the channels that were measured in each trial of the first recording.

        Args:
            scene: as in the first recording, with this one's motion; or the scenes of several trials.
            measured: as in `fit_tendons`, like `limits`, and `more`: progress, checkpoint and resume.

        Raises:
            InputError: another number of trials or frames, or other nominal parameters, than in the first recording.
            PftwinError: as `fit_tendons`.
        """
        s = self.set_up
        scenes, given = trials_of(scene, measured)
        s.check_frames(scenes, given[0].source)
        self._check_nominal(scenes)
        selected = [_with_channels(*each, s.springs) for each in zip(self.measured, scenes, given, strict=True)]
        names = ("free", "bounds", "priors", "nuisance", "varies", "noise", "springs")
        asked: dict[str, Any] = {name: getattr(s, name) for name in names}
        found = fit_tendons(scenes, selected, method=self.method, use=s.channels, limits=limits, **asked, **more)
        if not self.widened or found.reason.startswith("interrupted"):
            return found
        scale = np.append(self.widened, np.ones(len(found.names) - len(self.widened)))  # correlations stay the same
        covariance, widened = found.covariance * np.outer(scale, scale), dict(zip(s.free, self.widened, strict=True))
        return replace(found, covariance=covariance, widened=widened, plants=dict(self.plants), calibrated=s.scene_name)

    def _check_nominal(self, scenes: Sequence[Scene]) -> None:
        """Raises InputError for a scene with another nominal value of a free or nuisance parameter."""
        own = self.set_up.parameters(scenes)[1][0]
        if len(own.names) != len(self.nominal):
            said = f"scene {scenes[0].name!r} has {len(own.names)} free and nuisance parameters"
            raise InputError(said, where="nominal", expected=f"{len(self.nominal)}, as {self.set_up.scene_name!r} has")
        for name, value, expected in zip(own.names, own.nominal, self.nominal, strict=True):
            if not np.isclose(value, expected, rtol=_SAME, atol=_SAME):
                said = f"{name} is {value:.6g} in scene {scenes[0].name!r}"
                raise InputError(said, where="nominal", expected=f"{expected:.6g}, as in {self.set_up.scene_name!r}")

    def draws(
        self,
        scene: Scene | Sequence[Scene],
        measured: Measured | Sequence[Measured | None] | None = None,
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> tuple[Floats, list[str]]:
        """Draws (N, d) of the requested parameters, and doubts.

        Raises:
            PftwinError: as `fit_tendons`.
        """
        found = self.estimate(scene, measured, limits=limits)
        return interval_draws(found), found.doubts

    def sentence(self) -> str:
        """What is fitted, and by which method."""
        s = self.set_up
        said = f"fits by {self.method} of {comma_list(s.frames)} frames of {s.scene_name}, by {', '.join(s.channels)}"
        return said + widened_in_words(s.free, self.widened)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a JSON file, complete or not at all.

        Raises:
            OutputError: if it cannot be written.
        """
        own = {name: getattr(self, name) for name in ("method", "measured", "nominal", "widened", "plants")}
        write_json_file(path, {"format": FORMAT, "set_up": self.set_up.to_dict(), **own})
        return Path(path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> QuickFit:
        """Reads what `save` wrote.

        Raises:
            InputError: no such file, or it holds no such fit.
        """
        expected = f"a file of {FORMAT!r}, as `pftwin calibrate --method --widen` writes it"
        facts = restored_numbers(read_json(path, expected=expected))
        try:
            if facts.get("format") != FORMAT:
                raise ValueError(f"its format is {facts.get('format')!r}")
            set_up, method = SetUp.from_dict(facts["set_up"]), str(facts["method"])
            measured = tuple(tuple(map(str, channels)) for channels in facts["measured"])
            nominal, widened = (tuple(map(float, facts[key])) for key in ("nominal", "widened"))
            plants = {kind: int(count) for kind, count in facts["plants"].items()}
            if method not in METHODS:
                raise ValueError(f"no method {method!r}")
            if len(widened) not in (0, len(set_up.free)) or not all(1 <= times < np.inf for times in widened):
                raise ValueError(f"its factors are not those of {', '.join(set_up.free)}, at least 1")
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            raise InputError(f"no calibrated fit: {error}", where=path, expected=expected) from None
        return QuickFit(set_up, method, measured, nominal, widened, plants)


def interval_draws(estimate: Estimate) -> Floats:
    """Draws (N, d) of the requested parameters whose quantiles are the estimate's intervals.

    Not `samples`, which clips draws of a normal distribution at the bounds and adds differences between trials.
    """
    d, random = estimate.asked, np.random.default_rng(0)
    if estimate.draws is not None:
        return estimate.draws[:, :d]
    return random.multivariate_normal(estimate.values[:d], estimate.covariance[:d, :d], DRAWS, method="eigh")


def _with_channels(channels: Sequence[str], scene: Scene, data: Measured, springs: Mapping[str, str]) -> Measured:
    """The measurements without forces and readings of other channels."""
    forces = force_fields(scene, springs).items()
    absent: dict[str, Any] = {name: None for channel, name in forces if channel not in channels}
    return replace(data, **absent, readings={name: v for name, v in data.readings.items() if name in channels})
