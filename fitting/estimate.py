"""`Estimate`, the result of a fit: parameters, their uncertainty, and remarks on it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fitting import estimate_words as words
from fitting.coverage import Coverage, coverage_of, widened_coverage
from fitting.nuisance import EXACT, REACH, Nuisance
from fitting.parameters import Applied, weights_in
from fitting.uncertainty import NORMAL_95, Undetermined
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import read_json, restored_numbers, write_json_file
from pftwin.model.scene import Scene
from pftwin.results.verdict import INVALID

if TYPE_CHECKING:
    from fitting.plots import EstimatePlots
    from pftwin.model.measured import Measured

FORMAT = "pftwin estimate 1"
_ARRAYS = ("values", "covariance", "lower", "upper", "nominal")


class FittedTrial(NamedTuple):
    """One trial that was fitted: its nominal scene and its measurements."""

    nominal: Scene
    measured: Measured | None


@dataclass(eq=False)
class Estimate:
    """Estimated parameters with their uncertainty; arrays are in the order of `names`, in SI units."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats  # (p,)
    covariance: Floats  # (p, p)
    lower: Floats  # lower bounds (p,)
    upper: Floats  # upper bounds (p,)
    nominal: Floats  # the scene's values, where the search started (p,)
    objective: str
    objective_value: float
    objective_unit: str
    channels: tuple[str, ...]  # channels that were compared
    noise: dict[str, float]  # standard deviation of each channel's noise [m], [rad], [N]
    noise_known: bool  # whether it was stated, not estimated from the residuals
    serial_correlation: float  # correlation of neighbouring residuals
    condition: float  # condition number of the information on relative parameters
    rmse: dict[str, float]  # residual of each channel, and of X, Y, Z, rms [m], [rad], [N]
    method: str
    seed: int
    reason: str  # why the method stopped
    evaluations: int
    iterations: int
    starts: int  # number of starts, or of simulations if the posterior was learned from them
    dropped: int  # how many of these had no equilibrium or no finite motion
    seconds: float
    history: list[dict[str, float]]  # iteration, evaluations, best, spread
    synthetic: bool  # whether the measurements are synthetic
    source: str  # where the measurements come from
    scene_name: str
    notes: list[str] = field(default_factory=list)
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)
    nuisance: Nuisance = EXACT  # nuisance parameters' priors, and sensor errors
    auxiliary: tuple[str, ...] = ()  # nuisance parameters and differences between trials, the last of `names`
    kinds: tuple[str, ...] = ()  # of each parameter: `fitting.parameters.REQUESTED`, or the kind of nuisance
    varies: dict[str, float] = field(default_factory=dict)  # standard deviation between trials, by parameter
    differences: tuple[tuple[int, int], ...] = ()  # for each of the last parameters: index of its mean, and the trial
    springs: dict[str, str] = field(default_factory=dict)  # effects measured as femoral and tibial spring force
    verdict: str = ""  # on the fitted motion: "valid", or "INVALID" and why; empty if none was given
    status: str = ""  # of the fitted motion, in words; empty if none was given
    status_frames: dict[str, int] = field(default_factory=dict)  # frames of the fitted motion with each flag
    doubts: list[str] = field(default_factory=list)  # reasons to distrust the measurements or the fit
    time_shifts: dict[str, tuple[float, float]] = field(default_factory=dict)  # delay, its standard deviation [s]
    share: float = 1.0  # share of the likelihood that counts beside priors, if residuals are correlated
    draws: Floats | None = field(default=None, repr=False)  # posterior samples (N, p); None: a normal distribution
    coordinates: tuple[str, ...] = ()  # names of parameters that are coordinates of points
    step_error: dict[str, float] = field(default_factory=dict)  # rms error of the fit's time steps, units as `rmse`
    trial_rmse: dict[str, dict[str, float]] = field(default_factory=dict)  # `rmse` of each of several trials
    substeps: int = 0  # time steps between two frames; 0: not known
    values_compared: int = 0  # number of measured values that were compared; 0: not known
    readings: dict[str, str] = field(default_factory=dict)  # units of channels that are neither poses nor forces
    covariances: dict[str, list[list[float]]] = field(default_factory=dict)  # of noise that was stated as a covariance
    widened: dict[str, float] = field(default_factory=dict)  # factors of intervals, by parameter, after a calibration
    plants: dict[str, int] = field(default_factory=dict)  # number of plants of that calibration, by kind
    calibrated: str = ""  # scene of that calibration
    trials: tuple[FittedTrial, ...] = field(default=(), repr=False)  # what was fitted; empty if read from a file

    @property
    def standard_deviations(self) -> Floats:
        """Standard deviations (p,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def intervals(self) -> Floats:
        """95 % intervals (p, 2): quantiles of the draws, or of the normal distribution."""
        if self.draws is not None:
            return np.quantile(self.draws, (0.025, 0.975), axis=0).T
        return self.values[:, None] + NORMAL_95 * self.standard_deviations[:, None] * np.array([-1.0, 1.0])

    @property
    def correlation(self) -> Floats:
        """Correlation matrix of the parameters' errors (p, p)."""
        sd = np.maximum(self.standard_deviations, 1e-300)
        with np.errstate(invalid="ignore"):  # NaN beside an infinite variance
            return self.covariance / np.outer(sd, sd)

    @property
    def asked(self) -> int:
        """Number of requested parameters: the first of `names`; nuisance parameters follow."""
        return len(self.names) - len(self.auxiliary)

    @property
    def shared(self) -> int:
        """Number of parameters that trials share: the first of `names`; differences between trials follow."""
        return len(self.names) - len(self.differences)

    @property
    def in_trials(self) -> dict[str, dict[str, tuple[float, float]]]:
        """For each parameter that differs between trials, its value and standard deviation in each trial, by name.

        A coordinate is stated as in the first trial's scene; in other trials it is moved by the same amount.
        """
        found: dict[str, dict[str, tuple[float, float]]] = {}
        for at, trial in self.differences:
            weights = weights_in(self.differences, self.shared, trial)[at]
            estimated = float(weights @ self.values), float(np.sqrt(max(weights @ self.covariance @ weights, 0.0)))
            found.setdefault(self.names[at], {})[list(self.trial_rmse)[trial]] = estimated
        return found

    @property
    def coverage(self) -> Coverage:
        """Measured coverage of intervals, bands and plans of such fits, in words."""
        if self.widened:
            return widened_coverage(self.widened, self.plants, self.calibrated)
        nuisance, trials = len(self.auxiliary) > len(self.differences), len(self.trial_rmse) > 1
        return coverage_of(self.draws is not None, nuisance, trials, bool(self.varies))

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Parameters whose value, or interval by simulations, reaches a bound; the true value may lie beyond."""
        low, high = (self.values, self.values) if self.draws is None else self.intervals.T
        near = np.minimum(low - self.lower, self.upper - high) < 1e-3 * (self.upper - self.lower)
        return tuple(n for n, there in zip(self.names, near, strict=True) if there)

    @property
    def set_by_bounds(self) -> tuple[str, ...]:
        """Parameters whose value a search found at a bound: it was set by the bound, and its precision is not known,
        unless a calibration, which has such cases too, has widened the intervals."""
        return () if self.widened or self.draws is not None else self.at_bounds

    def bound_mark(self, name: str) -> str:
        """What tables and figures say beside a parameter of `at_bounds`; empty for others."""
        if name not in self.at_bounds:
            return ""
        return "at its bound" if self.draws is None else "interval to its bound"

    @property
    def undetermined(self) -> Undetermined:
        """Combinations of the requested parameters that are hardly known beyond bounds and priors."""
        asked = self.asked
        prior = np.array([self.priors.get(name, (0.0, np.inf))[1] for name in self.names[:asked]])
        known = np.minimum((self.upper - self.lower)[:asked] / np.sqrt(12), prior)
        return Undetermined.of(self.names[:asked], known, self.covariance[:asked, :asked])

    @property
    def nominal_scene(self) -> Scene | None:
        """The nominal scene of the (first) trial; None for an estimate read from a file."""
        return self.trials[0].nominal if self.trials else None

    @property
    def measured(self) -> Measured | None:
        """Measurements of the (first) trial; None for an estimate read from a file."""
        return self.trials[0].measured if self.trials else None

    @property
    def scene(self) -> Scene:
        """The fitted scene of the (first) trial.

        Raises:
            InputError: for an estimate read from a file, which holds no scene: use `apply`.
        """
        return self.scenes[0]

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The fitted scenes of all trials, with the shared values if fewer scenes were given than trials were fitted.

        Raises:
            InputError: as `scene`.
        """
        if not self.trials:
            raise InputError("an estimate from a file holds no scene", remedy="estimate.apply(scene)")
        whole = len(self.trials) == len(self.trial_rmse)  # otherwise it is not known which trials these are
        differences = self.differences if whole else tuple((at, -1) for at, _ in self.differences)
        each = [weights_in(differences, self.shared, k) @ self.values for k in range(len(self.trials))]
        return tuple(self.apply(trial.nominal, theta) for trial, theta in zip(self.trials, each, strict=True))

    def about(self, scene: Scene | Sequence[Scene]) -> Estimate:
        """A copy with the nominal scene of each trial, which a file does not hold, and the scenes' measurements."""
        scenes = [scene] if isinstance(scene, Scene) else scene
        return replace(self, trials=tuple(FittedTrial(self.nuisance.prepared(s), s.measured) for s in scenes))

    @property
    def apply(self) -> Applied:
        """A function: `estimate.apply(scene)` sets the estimated values in a scene, `estimate.apply(scene, theta)`
        other values (p,), those that trials share. Coordinates of points are applied as offsets: see `Applied`."""
        shared = self.names[: self.shared]
        nominal = dict(zip(shared, self.nominal.tolist(), strict=False))
        origins = tuple((name, nominal[name]) for name in self.coordinates if name in nominal)
        return Applied(shared, self.values[: self.shared], origins, self.nuisance)

    def samples(self, count: int, seed: int = 0) -> Floats:
        """Samples of the parameters (count, p): from the draws, or from the normal distribution clipped to the bounds.

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
        """Whether the values must not be used: the fitted motion is INVALID, or there are doubts."""
        return bool(self.objections())

    @property
    def objection(self) -> str:
        """See `fitting.prediction.predicting.Fitted`."""
        return self.sentence() if self.invalid else ""

    def objections(self) -> list[str]:
        """Why the values must not be used."""
        motion = [self.verdict.removeprefix(f"{INVALID}: ")] if self.verdict.startswith(INVALID) else []
        return [*(f"{reason} (the fitted motion)" for reason in motion), *self.doubts]

    def sentence(self) -> str:
        """The precision of the requested parameters in a sentence, or why it cannot be stated."""
        return words.sentence(self)

    def summary(self) -> str:
        """A text table of the values, with the remarks."""
        return words.summary(self)

    def untold(self) -> list[str]:
        """Combinations of parameters that the measurements do not determine."""
        return words.untold(self)

    def remarks(self) -> list[str]:
        """Remarks that qualify the values."""
        return words.remarks(self)

    @property
    def plot(self) -> EstimatePlots:
        """Figures of this estimate."""
        from fitting.plots import EstimatePlots

        return EstimatePlots(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with derived ones for readers of the file."""
        values = {k: getattr(self, k) for k in self.__dataclass_fields__ if k != "trials"}
        for key in _ARRAYS:
            values[key] = np.asarray(values[key]).tolist()
        values["draws"] = None if self.draws is None else [[float(f"{v:.7g}") for v in row] for row in self.draws]
        values["nuisance"] = asdict(self.nuisance)
        return {
            "format": FORMAT,
            "sentence": self.sentence(),
            "doubts": list(self.doubts),
            **values,
            "standard_deviations": self.standard_deviations.tolist(),
            "intervals_95": self.intervals.tolist(),
            "at_bounds": list(self.at_bounds),
            "in_trials": self.in_trials,
            "correlation": self.correlation.tolist(),
            "remarks": self.remarks(),
        }

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a JSON file, complete or not at all.

        Raises:
            OutputError: if it cannot be written.
        """
        write_json_file(path, self.to_dict())
        return Path(path)

    @staticmethod
    def load(path: str | os.PathLike[str], scene: Scene | Sequence[Scene] | None = None) -> Estimate:
        """Reads an estimate that `save` wrote.

        Args:
            path: of the JSON file.
            scene: the nominal scene, needed for `.scene`; or the scenes of all trials.

        Raises:
            InputError: if there is no such file, or it holds no estimate.
        """
        content = restored_numbers(read_json(path, expected=f"a file of {FORMAT!r}, as `pftwin fit -o` writes it"))
        try:
            if content.get("format") != FORMAT:
                raise ValueError(f"its format is {content.get('format')!r}")
            if "besides" in content:  # the key in older files
                content.setdefault("auxiliary", content["besides"])
            known = {f.name: f for f in fields(Estimate) if f.name != "trials"}
            needed = [n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
            if absent := [name for name in needed if name not in content]:
                raise ValueError(f"it lacks {absent[0]!r}")
            found = Estimate(**{k: v for k, v in content.items() if k in known})  # older files lack some with defaults
            for key in _ARRAYS:
                setattr(found, key, np.asarray(getattr(found, key), dtype=float))
            found.draws = None if found.draws is None else np.asarray(found.draws, dtype=float)
            for key in ("names", "units", "channels", "coordinates", "auxiliary", "kinds"):
                setattr(found, key, tuple(getattr(found, key)))
            found.differences = tuple((int(at), int(trial)) for at, trial in found.differences)
            found.nuisance = Nuisance(**content.get("nuisance", {}))
            found.doubts = [str(doubt) for doubt in found.doubts]
            found.priors = {k: (v[0], v[1]) for k, v in found.priors.items()}
            found.time_shifts = {k: (v[0], v[1]) for k, v in found.time_shifts.items()}
        except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
            raise InputError(f"no estimate: {error}", where=path, expected=f"a file of {FORMAT!r}") from None
        return found if scene is None else found.about(scene)
