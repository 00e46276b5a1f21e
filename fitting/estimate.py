"""The result of a fit: parameters and their uncertainty."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fitting.coverage import Coverage, coverage_of
from fitting.nuisance import EXACT, REACH, Nuisance
from fitting.parameters import Applied, weights_in
from fitting.programs import unit_of
from fitting.sensors import sensors_in_words
from fitting.uncertainty import NORMAL_95, SERIAL, Undetermined, in_words
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import shown
from pftwin.base.text_files import read_json, restored_numbers, write_json_file
from pftwin.model.scene import Scene
from pftwin.results.verdict import INVALID

if TYPE_CHECKING:
    from fitting.plots import EstimatePlots
    from pftwin.model.measured import Measured

FORMAT = "pftwin estimate 1"
_ARRAYS = ("values", "covariance", "lower", "upper", "nominal")


class FittedTrial(NamedTuple):
    """What a fit was of."""

    nominal: Scene
    measured: Measured | None


@dataclass(eq=False)
class Estimate:
    """Parameters with their uncertainty. Arrays are in the order of `names`."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats  # (p,)
    covariance: Floats  # (p, p)
    lower: Floats  # bounds (p,)
    upper: Floats
    nominal: Floats  # the scene's values, where the search began (p,)
    objective: str
    objective_value: float
    objective_unit: str
    channels: tuple[str, ...]  # what was compared
    noise: dict[str, float]  # standard deviation of every channel [m], [rad], [N]
    noise_known: bool  # given, rather than estimated from the residuals
    serial_correlation: float  # of neighbouring residuals
    condition: float  # condition number of the information on relative parameters
    rmse: dict[str, float]  # of every channel, and of X, Y, Z [m], [rad], [N]
    method: str
    seed: int
    reason: str  # why it stopped
    evaluations: int
    iterations: int
    starts: int  # or simulations, where the posterior was learned from them
    dropped: int  # of these without an equilibrium or a finite motion
    seconds: float
    history: list[dict[str, float]]  # iteration, evaluations, best, spread
    synthetic: bool  # whether the measurements are
    source: str  # of the measurements
    scene_name: str
    notes: list[str] = field(default_factory=list)
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)
    nuisance: Nuisance = EXACT  # what was taken as not known, and fitted besides
    besides: tuple[str, ...] = ()  # names of its numbers, and of differences of trials, the last of `names`
    kinds: tuple[str, ...] = ()  # of each parameter: `fitting.parameters.ASKED`, or of what nuisance it is
    varies: dict[str, float] = field(default_factory=dict)  # by what deviation a parameter differs between trials
    differences: tuple[tuple[int, int], ...] = ()  # of the last parameters: to which each is added, in which trial
    springs: dict[str, str] = field(default_factory=dict)  # whose tensions the femoral and tibial spring forces are
    verdict: str = ""  # on the fitted motion: "valid", or "INVALID" and why; empty where none was given
    status: str = ""  # of the fitted motion, in words; empty where none was given
    status_frames: dict[str, int] = field(default_factory=dict)  # frames of the fitted motion with each flag
    doubts: list[str] = field(default_factory=list)  # what the measurements look like, if not what they are taken for
    time_shifts: dict[str, tuple[float, float]] = field(default_factory=dict)  # late by, deviation [s]
    share: float = 1.0  # of the likelihood that counts beside the priors, for correlated residuals
    draws: Floats | None = field(default=None, repr=False)  # (N, p) from the posterior; None: it is taken as normal
    coordinates: tuple[str, ...] = ()  # names of parameters that are coordinates of points
    step_error: dict[str, float] = field(default_factory=dict)  # of the fit's time steps, rms, units as of `rmse`
    trial_rmse: dict[str, dict[str, float]] = field(default_factory=dict)  # as `rmse`, of each of several trials
    substeps: int = 0  # between two frames, of the answer; 0: not known
    readings: dict[str, str] = field(default_factory=dict)  # units of channels that are no poses and forces
    covariances: dict[str, list[list[float]]] = field(default_factory=dict)  # of noise that was stated so
    trials: tuple[FittedTrial, ...] = field(default=(), repr=False)  # what was fitted; none of a file

    @property
    def standard_deviations(self) -> Floats:
        """(p,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def intervals(self) -> Floats:
        """95 % intervals (p, 2)."""
        if self.draws is not None:
            return np.quantile(self.draws, (0.025, 0.975), axis=0).T
        return self.values[:, None] + NORMAL_95 * self.standard_deviations[:, None] * np.array([-1.0, 1.0])

    @property
    def correlation(self) -> Floats:
        """(p, p)."""
        sd = np.maximum(self.standard_deviations, 1e-300)
        with np.errstate(invalid="ignore"):  # NaN beside an infinite variance
            return self.covariance / np.outer(sd, sd)

    @property
    def asked(self) -> int:
        """How many parameters were asked for: the first of `names`; nuisance follows."""
        return len(self.names) - len(self.besides)

    @property
    def shared(self) -> int:
        """How many parameters trials share: the first of `names`; differences of trials follow."""
        return len(self.names) - len(self.differences)

    @property
    def in_trials(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Of each parameter that differs between trials its value in each, by name, and that one's standard deviation.

        A coordinate is told as in the first trial's scene: in others it is moved by as much.
        """
        found: dict[str, dict[str, tuple[float, float]]] = {}
        for at, trial in self.differences:
            weights = weights_in(self.differences, self.shared, trial)[at]
            told = float(weights @ self.values), float(np.sqrt(max(weights @ self.covariance @ weights, 0.0)))
            found.setdefault(self.names[at], {})[list(self.trial_rmse)[trial]] = told
        return found

    @property
    def coverage(self) -> Coverage:
        """How often intervals, bands and plans of such fits held where the truth was known, in words."""
        return coverage_of(self.draws is not None, len(self.besides) > len(self.differences), len(self.trial_rmse) > 1)

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Parameters whose value, or whose interval by simulations, reaches a bound: the true one may lie beyond."""
        low, high = (self.values, self.values) if self.draws is None else self.intervals.T
        near = np.minimum(low - self.lower, self.upper - high) < 1e-3 * (self.upper - self.lower)
        return tuple(n for n, there in zip(self.names, near, strict=True) if there)

    @property
    def undetermined(self) -> Undetermined:
        """Combinations of what was asked for that are hardly told but by bounds and priors."""
        asked = self.asked
        prior = np.array([self.priors.get(name, (0.0, np.inf))[1] for name in self.names[:asked]])
        known = np.minimum((self.upper - self.lower)[:asked] / np.sqrt(12), prior)
        return Undetermined.of(self.names[:asked], known, self.covariance[:asked, :asked])

    @property
    def nominal_scene(self) -> Scene | None:
        """The scene that was fitted, of several trials that of the first; None of an estimate from a file."""
        return self.trials[0].nominal if self.trials else None

    @property
    def measured(self) -> Measured | None:
        """What it was fitted to, likewise."""
        return self.trials[0].measured if self.trials else None

    @property
    def scene(self) -> Scene:
        """The fitted scene, of several trials that of the first.

        Raises:
            InputError: an estimate from a file, which holds no scene: use `apply`.
        """
        return self.scenes[0]

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The fitted scenes of all trials.

        Where a file was given fewer scenes than it was fitted to, with what trials share.

        Raises:
            InputError: as `scene`.
        """
        if not self.trials:
            raise InputError("an estimate from a file holds no scene", remedy="estimate.apply(scene)")
        whole = len(self.trials) == len(self.trial_rmse)  # else nobody knows which trials these are
        differences = self.differences if whole else tuple((at, -1) for at, _ in self.differences)
        each = [weights_in(differences, self.shared, k) @ self.values for k in range(len(self.trials))]
        return tuple(self.apply(trial.nominal, theta) for trial, theta in zip(self.trials, each, strict=True))

    def about(self, scene: Scene | Sequence[Scene]) -> Estimate:
        """The same estimate, with the nominal scenes that a file does not hold, and their measurements."""
        scenes = [scene] if isinstance(scene, Scene) else scene
        return replace(self, trials=tuple(FittedTrial(self.nuisance.prepared(s), s.measured) for s in scenes))

    @property
    def apply(self) -> Applied:
        """`estimate.apply(scene)` has the estimated values, `estimate.apply(scene, theta)` others (p,).

        They are those that trials share. Coordinates of points are carried as offsets: see `Applied`.
        """
        shared = self.names[: self.shared]
        nominal = dict(zip(shared, self.nominal.tolist(), strict=False))
        origins = tuple((name, nominal[name]) for name in self.coordinates if name in nominal)
        return Applied(shared, self.values[: self.shared], origins, self.nuisance)

    def samples(self, count: int, seed: int = 0) -> Floats:
        """Parameters (count, p) as uncertain as the estimate: of its draws, or normal and kept within the bounds.

        A parameter that differs between trials is drawn for a further trial.
        """
        random = np.random.default_rng(seed)
        if self.draws is not None:
            found = self.draws[random.choice(len(self.draws), count, replace=count > len(self.draws))]
        else:
            values, vectors = np.linalg.eigh(self.covariance)
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            normal = random.standard_normal((count, len(self.values)))
            found = np.clip(self.values + normal @ root.T, self.lower, self.upper)
        for name, deviation in self.varies.items():
            further = np.clip(random.standard_normal(count), -REACH, REACH)
            found[:, self.names.index(name)] += deviation * further
        return found

    @property
    def invalid(self) -> bool:
        """Whether nothing can be said of the values: the fitted motion may not be spoken of, or data contradict it."""
        return bool(self._objections())

    def _objections(self) -> list[str]:
        motion = [self.verdict.removeprefix(f"{INVALID}: ")] if self.verdict.startswith(INVALID) else []
        return [*(f"{reason} (the fitted motion)" for reason in motion), *self.doubts]

    def sentence(self) -> str:
        """The precision of the parameters asked for, in a sentence, or what forbids to speak of it."""
        asked = self.asked
        if self.invalid:
            untold = f"What the data tell of {', '.join(self.names[:asked])} is not known"
            return f"{INVALID}: {'; '.join(self._objections())}. {untold}"
        span, covariance = self.upper - self.lower, self.covariance[:asked, :asked]
        said = in_words(
            self.names[:asked],
            span[:asked],
            self.values[:asked],
            covariance,
            self.channels,
            self.coordinates,
            self.readings,
            self.units[:asked],
        )
        return f"{said}. {'But ' if self.draws is None else ''}{self.coverage.intervals}"

    def summary(self) -> str:
        """A table in text, with the remarks."""
        lines = [self.sentence()] if self.invalid else []
        lines.append(f"{self.scene_name}: {self.method}, objective {self.objective} = {self.objective_value:.6g}")
        for i, name in enumerate(self.names):
            low, high = self.intervals[i]
            lines += ["besides:"] if name == next(iter(self.besides), None) else []
            lines.append(
                f"  {name:<12} {self.values[i]:.6g} +- {self.standard_deviations[i]:.2g} {self.units[i]}"
                f"  (95 %: {low:.6g} to {high:.6g}; nominal {self.nominal[i]:.6g})"
            )
        for name, told in self.in_trials.items():
            unit = self.units[self.names.index(name)]
            lines += [f"  {name} in {trial}: {value:.6g} +- {sd:.2g} {unit}" for trial, (value, sd) in told.items()]
        lines += [*([] if self.invalid else [self.sentence()]), *self.remarks(), f"stopped: {self.reason}"]
        return "\n".join(lines)

    def untold(self) -> list[str]:
        """What the measurements do not tell: combinations left to bounds and priors, values at a bound."""
        out = []
        if (open_ := self.undetermined).count and not self.invalid:
            told = f"{self.asked - open_.count} of {self.asked} combinations of what was asked for"
            hardly = f"hardly more than bounds and priors do ({', '.join(open_.names)})"
            out.append(f"the measurements tell {told}, and of the others {hardly}")
        if self.at_bounds:
            out.append(f"at a bound: {', '.join(self.at_bounds)}; the true value may lie beyond")
        return out

    def remarks(self) -> list[str]:
        """Remarks that qualify the numbers."""
        out = list(self.notes)
        if self.synthetic:
            out.append("the measurements are synthetic")
        for channel in self.channels if self.trial_rmse else ():
            of_each = {name: left[channel] for name, left in self.trial_rmse.items() if channel in left}
            unit = unit_of(channel, self.readings)
            parts = [f"{shown(left, unit, 3)} in {name}" for name, left in of_each.items()]
            out.append(f"left of {channel}: {', '.join(parts)}")
        out += self.untold()
        if self.serial_correlation > SERIAL:
            out.append(
                f"residuals are autocorrelated ({self.serial_correlation:.2f} from frame to frame), by errors of the "
                "model or by the filter; intervals allow for the correlation, not for a wrong model"
            )
        if self.share < 1:
            out.append(
                f"beside the priors the measurements count as {100 * self.share:.2g} % of as many independent ones"
            )
        if errors := sensors_in_words(self.nuisance):
            out.append(f"allowed for throughout the recording, one standard deviation: {errors}")
        if self.dropped:
            tried = "starts" if self.draws is None else "simulations"
            out.append(f"{self.dropped} of {self.starts} {tried} found no equilibrium or no finite motion")
        return out

    @property
    def plot(self) -> EstimatePlots:
        """Figures."""
        from fitting.plots import EstimatePlots

        return EstimatePlots(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON, with derived ones for readers of the file."""
        plain = {k: getattr(self, k) for k in self.__dataclass_fields__ if k != "trials"}
        for key in _ARRAYS:
            plain[key] = np.asarray(plain[key]).tolist()
        plain["draws"] = None if self.draws is None else [[float(f"{v:.7g}") for v in row] for row in self.draws]
        plain["nuisance"] = asdict(self.nuisance)
        return {
            "format": FORMAT,
            "sentence": self.sentence(),
            "doubts": list(self.doubts),
            **plain,
            "standard_deviations": self.standard_deviations.tolist(),
            "intervals_95": self.intervals.tolist(),
            "in_trials": self.in_trials,
            "correlation": self.correlation.tolist(),
            "remarks": self.remarks(),
        }

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes JSON, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        write_json_file(path, self.to_dict())
        return Path(path)

    @staticmethod
    def load(path: str | os.PathLike[str], scene: Scene | Sequence[Scene] | None = None) -> Estimate:
        """Reads an estimate that `save` wrote.

        Args:
            path: of the JSON file.
            scene: the nominal scene, needed for `.scene`; of several trials those of all.

        Raises:
            InputError: no such file, or one that holds no estimate.
        """
        content = restored_numbers(read_json(path, expected=f"a file of {FORMAT!r}, as `pftwin fit -o` writes it"))
        try:
            if content.get("format") != FORMAT:
                raise ValueError(f"its format is {content.get('format')!r}")
            known = {f.name: f for f in fields(Estimate) if f.name != "trials"}
            needed = [n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
            if absent := [name for name in needed if name not in content]:
                raise ValueError(f"it lacks {absent[0]!r}")
            found = Estimate(**{k: v for k, v in content.items() if k in known})  # older files lack some with defaults
            for key in _ARRAYS:
                setattr(found, key, np.asarray(getattr(found, key), dtype=float))
            found.draws = None if found.draws is None else np.asarray(found.draws, dtype=float)
            for key in ("names", "units", "channels", "coordinates", "besides", "kinds"):
                setattr(found, key, tuple(getattr(found, key)))
            found.differences = tuple((int(at), int(trial)) for at, trial in found.differences)
            found.nuisance = Nuisance(**content.get("nuisance", {}))
            found.doubts = [str(doubt) for doubt in found.doubts]
            found.priors = {k: (v[0], v[1]) for k, v in found.priors.items()}
            found.time_shifts = {k: (v[0], v[1]) for k, v in found.time_shifts.items()}
        except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
            raise InputError(f"no estimate: {error}", where=path, expected=f"a file of {FORMAT!r}") from None
        return found if scene is None else found.about(scene)
