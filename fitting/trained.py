"""`TrainedPosterior`: trained once for a set-up, it answers each of its recordings (`fitting.train_posterior`)."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fitting.channel_checks import Limits, bounded, limits_of
from fitting.estimate import Estimate
from fitting.evaluation import Prediction
from fitting.first_look import check_by_differences
from fitting.fit import SIMULATIONS
from fitting.inference.infer import DRAWS, TOGETHER, Inferred
from fitting.inference.learning import Answer, Learned
from fitting.inference.nuisance_draws import at_own_lengths, with_nuisance
from fitting.inference.recordings import Noise, Summaries, SummaryNoise, Table
from fitting.inference.region import Region
from fitting.methods.problem import Problem
from fitting.nuisance import Nuisance
from fitting.objective import Objective
from fitting.outcome import Outcome, estimate_of, judge
from fitting.set_up import SetUp, comma_list, from_nominal, refuse_weights, relative_measurements, widened_in_words
from fitting.trials import Recordings, Scenes, trials_of
from pftwin.base.arrays import Floats, Rows
from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.dynamics.simulate import compiled_aside
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

FORMAT = "pftwin trained posterior 2"
_FEWEST_PROBES = 0.5  # share of the probes that must run
_DRAWN = 1000  # draws of each posterior to compare


class Probes(NamedTuple):
    """Knees simulated in training, which are simulated again in a recording's set-up to measure how it differs."""

    theta: Floats  # (N, p)
    recordings: Rows  # (N, n, m) without noise, relative to the nominal knee's


@dataclass(frozen=True, eq=False)
class TrainedPosterior:
    """The posterior of every recording of a set-up.

    A recording is compared with the nominal knee in its own motion, so femur and tibia need not move exactly as in
    training. Whether motion and set-up are similar enough is measured with probes, knees simulated in both: the shift
    of their posteriors is the error to expect of this recording's.
    """

    set_up: SetUp
    learned: Learned
    probes: Probes
    present: NDArray[np.bool_]  # (n, m) which values recordings have
    substeps: int  # time steps between two frames
    simulations: int
    dropped: int  # simulations without an equilibrium or a finite motion
    seed: int
    seconds: float  # duration of the training [s]
    widened: tuple[float, ...] = ()  # factors (d,) by which intervals are widened after a calibration
    plants: Mapping[str, int] = field(default_factory=dict)  # number of plants of that calibration, by kind
    doubts: tuple[str, ...] = ()  # about the recording that it was trained on

    def estimate(
        self,
        scene: Scene | Sequence[Scene],
        measured: Measured | Sequence[Measured | None] | None = None,
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> Estimate:
        """Estimates the parameters from a recording of this set-up.

        Args:
            scene: scene as in training, with the motion of this recording; or the scenes of several trials.
            measured: as in `fit_tendons`, like `limits`.

        Raises:
            InputError: another number of frames, or weights of them; channels that were not measured; a set-up or a
                recording that differs from those simulated by more than the limits allow; as `fit_tendons`.
            PftwinError: the posterior lies beyond the bounds.
        """
        began, allowed = time.perf_counter(), limits_of(limits)
        problem, given = self._problem(scene, measured, self.set_up)
        compiled = compiled_aside(problem.scene.unnamed())
        doubts = check_by_differences(problem, allowed)
        answer, draws, extra, more = self._answer(problem, allowed)
        problem, given = self._problem(scene, measured, self.set_up._replace(nuisance=extra))
        reason = f"a posterior trained by {self.simulations - self.dropped} simulations answered"
        found = Inferred(
            answer._replace(draws=draws), self.learned.noise, self.simulations, self.dropped, self.substeps, [], reason
        )
        outcome = Outcome.of_simulations(problem, found, self.seed, allowed)
        doubts = [*(f"{doubt} (in training)" for doubt in self.doubts), *doubts, *more]
        of = (SIMULATIONS, given, self.set_up.springs, extra, doubts, allowed, began)
        estimate = estimate_of(problem, outcome, *of)
        if self.plants:
            estimate.widened = dict(zip(self.set_up.free, self.widened, strict=True))
            estimate.plants, estimate.calibrated = dict(self.plants), self.set_up.scene_name
        compiled()
        judge(estimate)
        return estimate

    def draws(
        self,
        scene: Scene | Sequence[Scene],
        measured: Measured | Sequence[Measured | None] | None = None,
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> tuple[Floats, list[str]]:
        """Draws (N, d) of the requested parameters, and doubts: as `estimate`, without checking other readings of the
        measurements or the fitted motion.

        Raises:
            PftwinError: as `estimate`.
        """
        allowed, problem = limits_of(limits), self._problem(scene, measured, self.set_up)[0]
        answer, draws, _, doubts = self._answer(problem, allowed)
        return draws[:, : problem.parameters.asked], doubts + answer.doubts(problem.objective.source, allowed)

    @staticmethod
    def _problem(scene: Scenes, measured: Recordings, set_up: SetUp) -> tuple[Problem, list[Measured]]:
        """The problem to answer, and the measurements of every trial."""
        nominal, given = trials_of(scene, measured)
        scenes, parameters = set_up.parameters(nominal)
        refuse_weights(given)
        problem = Problem.of(scenes, parameters, set_up.objective(scenes, given))
        problem.evaluator.prepare(TOGETHER)
        return problem, given

    def _answer(self, problem: Problem, limits: Limits) -> tuple[Answer, Floats, Nuisance, list[str]]:
        """Posterior without nuisance, draws (N, p) with it, nuisance with the lengths they refer to, and doubts."""
        held, prediction = from_nominal(problem, self.substeps, self.probes.theta)
        source = problem.objective.source
        off = self._set_up_error(held, prediction)
        said = f"in this motion and set-up the error of the trained posterior is {off.max():.2g} standard deviations"
        doubts = bounded("set_up", float(off.max()), said, source, limits)
        recording = relative_measurements(problem, held, self.present)
        wider = np.hypot(1.0, off) * (self.widened or 1.0)
        answer = self.learned.answer(recording, DRAWS, np.random.default_rng(self.seed), wider)
        said = f"the part of them that no simulation explains is {answer.level:.2g} times the training noise"
        doubts += bounded("trained_noise", answer.level, said, source, limits)
        random, nuisance = np.random.default_rng([self.seed, 1]), self.set_up.nuisance
        draws = with_nuisance(problem, nuisance, held, self.learned, recording, answer.draws, self.substeps, random)
        extra, draws = at_own_lengths(problem, nuisance, draws)
        return answer, draws, extra, doubts

    def _set_up_error(self, held: Objective, prediction: Prediction) -> Floats:
        """Shift of the posteriors (d,) of the probes between training and this motion and set-up, each relative to its
        own nominal knee: rms, in standard deviations of the posteriors.
        Raises InputError if most of the probes do not run."""
        if prediction.usable.mean() < _FEWEST_PROBES:
            found = "most knees that the posterior was trained with do not run"
            raise InputError(found, where=held.source, expected="the set-up that it was trained for")
        moved = held.residuals(prediction.values[prediction.usable]).astype(np.float32)
        ends = []
        for each in (self.probes.recordings[prediction.usable], moved):
            random = np.random.default_rng(self.seed)  # the same for both
            u = self.learned.coordinates_drawn(self.learned.scaled_summaries(each), _DRAWN, random)
            ends.append((u.mean(axis=1), u.std(axis=1)))
        (mean, sd), (other, _) = ends
        return np.asarray(np.sqrt(np.mean(((other - mean) / sd) ** 2, axis=0)))

    def facts(self) -> dict[str, Any]:
        """Plain values, for JSON and the file."""
        return {"format": FORMAT, **self.set_up.to_dict(), **{key: getattr(self, key) for key in _FACTS}}

    def sentence(self) -> str:
        """Which recordings it answers, and from what it was learned."""
        s = self.set_up
        return (
            f"answers recordings of {comma_list(s.frames)} frames of {s.scene_name}, by {', '.join(s.channels)}; "
            f"learned from {self.simulations - self.dropped:,} simulations in {self.seconds:.0f} s"
            + widened_in_words(s.free, self.widened)
            + "".join(f"; INVALID: {doubt}" for doubt in self.doubts)
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a NumPy file (.npz), complete or not at all.

        Raises:
            OutputError: if it cannot be written.
        """
        from fitting.inference.network import leaves_of

        target, own = Path(path), self.learned
        facts = {**self.facts(), "block": own.table.block, "span": own.noise.span, "usual": own.usual}
        facts["networks"] = len(own.networks)
        arrays: dict[str, Any] = {key: getattr(own, key) for key in _ARRAYS} | {"present": self.present}
        arrays |= {"deviations": own.noise.deviations, "correlations": own.noise.correlations, "root": own.added.root}
        for name, part in (("summaries", own.summaries), ("probes", self.probes)):
            arrays |= {f"{name}_{key}": value for key, value in part._asdict().items()}
        for i, net in enumerate(own.networks):
            arrays |= {f"network{i}_{j}": leaf for j, leaf in enumerate(leaves_of(net))}
        with written_whole(target) as temporary, temporary.open("wb") as file:
            np.savez(file, facts=np.array(json.dumps(facts)), **arrays)
        return target

    @staticmethod
    def load(path: str | os.PathLike[str], scene: Scene | Sequence[Scene]) -> TrainedPosterior:
        """Reads what `save` wrote.

        Args:
            path: of the file.
            scene: the scene of the set-up, or those of its trials.

        Raises:
            InputError: no such file, or no trained posterior in it; a scene without its parameters.
        """
        from fitting.inference.network import network_of

        try:
            with np.load(path, allow_pickle=False) as file:
                held = {key: file[key] for key in file.files}
            facts = json.loads(str(held["facts"]))
            if facts["format"] != FORMAT:
                raise ValueError(f"its format is {facts['format']!r}")
            set_up = SetUp.from_dict(facts)
            noise = Noise(held["deviations"], held["correlations"], facts["span"])
            summaries = Summaries(*(held[f"summaries_{key}"] for key in Summaries._fields))
            probes = Probes(*(held[f"probes_{key}"] for key in Probes._fields))
            arrays = {key: held[key] for key in _ARRAYS}
            sizes = (summaries.directions.shape[1], arrays["center"].size)
            nets = []
            for i in range(facts["networks"]):
                count = sum(key.startswith(f"network{i}_") for key in held)
                nets.append(network_of(*sizes, [held[f"network{i}_{j}"] for j in range(count)]))
            table = Table(facts["block"], noise.deviations)
            facts.setdefault("plants", {})  # older files have none
            rest: dict[str, Any] = {key: facts[key] for key in _FACTS}
            rest |= {key: tuple(facts[key]) for key in ("widened", "doubts")}
            noise_facts = {"noise": noise, "added": SummaryNoise(held["root"], noise.span), "usual": facts["usual"]}
            present = held["present"]
        except FileNotFoundError:
            raise InputError("no such file", where=path, expected=_EXPECTED) from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, BadZipFile) as error:
            raise InputError(f"no trained posterior: {error}", where=path, expected=_EXPECTED) from None
        region = Region(set_up.parameters([scene] if isinstance(scene, Scene) else list(scene))[1][0])
        learned = Learned(region, tuple(nets), table, summaries, **arrays, **noise_facts)
        return TrainedPosterior(set_up, learned, probes, present, **rest)


_EXPECTED = f"a file of {FORMAT!r}, as `pftwin train-posterior -o` writes it"
_FACTS = ("substeps", "simulations", "dropped", "seed", "seconds", "widened", "plants", "doubts")
_ARRAYS = ("middle", "size", "center", "scale")
