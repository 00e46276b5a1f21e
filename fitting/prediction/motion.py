"""A fitted knee in a recording, with bands, beside what was measured there.

A band holds what the estimate does not know, by draws, and what the model left of the measurements that it was fitted
to: each draw is widened by a normal error with the root mean square of what the fit left of the same coordinate. So it
is a band of what will be measured of a knee that the model fits in this recording as well as in the one before. It
knows nothing of what this recording alone has, such as another load.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fitting.estimate import Estimate
from fitting.prediction.predicting import check_draws, estimate_and_draws
from fitting.programs import TURNS
from pftwin.base.errors import InputError
from pftwin.base.leaves import number
from pftwin.base.rotations import patellar_angles
from pftwin.base.spatial import Quaternion
from pftwin.dynamics.batch.simulate_batch import simulate_batch
from pftwin.dynamics.batch.variants import Variants
from pftwin.model.measured import SYNTHETIC, Measured
from pftwin.model.scene import Scene, check
from pftwin.model.scene_parameters import find
from pftwin.results.verdict import is_invalid, verdict_of_counts

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

LEVEL = 0.9  # of bands
COORDINATES = {  # unit, meaning
    "x": ("mm", "centre, proximal"),
    "y": ("mm", "centre, lateral"),
    "z": ("mm", "centre, anterior"),
    "flexion": ("deg", "patellar flexion"),
    "rotation": ("deg", "rotation, internal positive"),
    "tilt": ("deg", "tilt, lateral positive"),
}
_QUANTILES = 401  # of the normal error that widens each draw
_MOST_FAILED = 0.1  # share of the draws without a motion that a band may leave out
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """Of n frames and the six `COORDINATES`, in their units.

    times: (n,) [s].
    value, low, high: (n, 6) of the estimate itself, and the band's ends.
    measured: (n, 6), NaN where it was not; None where nothing was.
    compared: (n,) frames that are held against the measurements.
    verdict: on the motion of the estimate, "valid" or "INVALID: ...".
    notes: what qualifies the bands.
    """

    scene_name: str
    times: Floats
    value: Floats
    low: Floats
    high: Floats
    measured: Floats | None
    compared: NDArray[np.bool_]
    verdict: str
    notes: tuple[str, ...]

    @property
    def errors(self) -> dict[str, float]:
        """Root mean square errors of the coordinates, and the mean distance, over the frames compared; else none."""
        if self.measured is None or not self.compared.any():
            return {}
        off = (self.value - self.measured)[self.compared]
        found = {"mean_distance": float(np.nanmean(np.linalg.norm(off[:, :3], axis=1)))}
        for k, name in enumerate(COORDINATES):
            if np.isfinite(off[:, k]).any():
                found[name] = float(np.sqrt(np.nanmean(off[:, k] ** 2)))
        return found

    @property
    def held(self) -> dict[str, float]:
        """The share of the frames compared whose measurement lies in the band, by coordinate."""
        if self.measured is None:
            return {}
        seen, low, high = (a[self.compared] for a in (self.measured, self.low, self.high))
        inside, found = (seen >= low) & (seen <= high), {}
        for k, name in enumerate(COORDINATES):
            if (there := np.isfinite(seen[:, k])).any():
                found[name] = float(inside[there, k].mean())
        return found

    @property
    def all_held(self) -> float | None:
        """The same of all coordinates together."""
        return float(np.mean(list(self.held.values()))) if self.held else None

    def sentence(self) -> str:
        """What came out."""
        if self.verdict != "valid":
            return self.verdict
        if not self.errors:
            return f"{self.scene_name}: {self.times.size} frames predicted; nothing was measured there"
        e, held, count = self.errors, self.all_held or 0.0, int(self.compared.sum())
        angles = "".join(f", {name} {e[name]:.2g} deg rms" for name in ("rotation", "flexion", "tilt") if name in e)
        return (
            f"{self.scene_name}: {e['mean_distance']:.2g} mm from the measured path on average of {count} frames"
            f"{angles}; bands of {100 * LEVEL:.0f} % held {100 * held:.0f} % of what was measured"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        told = {"scene": self.scene_name, "verdict": self.verdict, "level": LEVEL, "notes": list(self.notes)}
        return {**told, "errors": self.errors, "held": self.held, "sentence": self.sentence()}

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Coordinate, unit, root mean square error, share of frames that the band holds."""
        return [
            (meaning, unit, f"{self.errors[name]:.2f}", f"{100 * self.held[name]:.0f} %")
            for name, (unit, meaning) in COORDINATES.items()
            if name in self.errors
        ]

    def dataset(self) -> Dataset:
        """Everything, over time and coordinate."""
        from xarray import Dataset

        axes = ("time", "coordinate")
        given = {"value": self.value, "low": self.low, "high": self.high}
        given |= {} if self.measured is None else {"measured": self.measured}
        words = {"value": "of the estimate", "low": "band, lower end", "high": "band, upper end"}
        variables = {name: (axes, a, {"long_name": words.get(name, name)}) for name, a in given.items()}
        coordinates = {
            "time": (("time",), self.times, {"units": "s", "long_name": "time"}),
            "coordinate": (("coordinate",), list(COORDINATES), {"long_name": "of the patella in the femur"}),
            "unit": (("coordinate",), [unit for unit, _ in COORDINATES.values()], {"long_name": "its unit"}),
            "compared": (("time",), self.compared, {"long_name": "held against the measurements", "units": "1"}),
        }
        about = {"title": f"predicted motion: {self.scene_name}", "level": LEVEL, "verdict": self.verdict}
        return Dataset(variables, coordinates, {**about, "note": "; ".join(self.notes)})

    def figure(self) -> Figure:
        """Six panels over time: the band, the estimate's motion, and what was measured."""
        from fitting.prediction.motion_figure import motion_figure

        return motion_figure(self)


def predict_motion(
    scene: Scene,
    estimate: Estimate,
    measured: Measured | None = None,
    *,
    samples: int = 50,
    seed: int = 0,
    values: Mapping[str, float | tuple[float, float]] | None = None,
    dt: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PredictedMotion:
    """The motion of a fitted knee, with bands for what will be measured of it.

    Args:
        scene: nominal, in the recording that is predicted.
        estimate: of the same knee, in this recording or another.
        measured: what was measured there, at the scene's frames; frames of weight 0 are not compared. By default what
            the scene carries.
        samples: draws from the estimate.
        seed: of the draws.
        values: numbers of the scene that are other in this recording, by name: what they are, or between what they lie.
        dt: as `pftwin.simulate_batch` has it.
        progress: called with the number of motions done and of all.

    Raises:
        InputError: a scene without the estimate's parameters; an estimate of which nothing of position and orientation
            is known; no draws; values of unknown numbers, or outside of what they can be.
    """
    check_draws(samples, estimate)
    if samples < 1:
        raise InputError("no draws", where="samples", expected="at least 1: bands are made of them")
    left = _left_of(estimate)
    thetas = estimate_and_draws(estimate, samples, seed)[:, : estimate.shared]
    scene, thetas = _with_values(scene, estimate, thetas, values or {}, np.random.default_rng(seed))
    check(estimate.apply(scene))
    found = simulate_batch(Variants(scene, estimate.apply, thetas), dt=dt, trajectories=True, progress=progress)
    frames = scene.motion.times.size
    counts = found["status_frames"].values
    good = ~(found["failed"].values | is_invalid(counts, frames))
    paths = _coordinates(found["sphere_center"].values, found["patella_quaternion"].values)
    verdict = verdict_of_counts(counts[0], frames).describe()
    lost = int((~good[1:]).sum())
    if verdict == "valid" and lost > _MOST_FAILED * samples:
        verdict = f"INVALID: {lost} of {samples} draws have no motion that may be spoken of"
    notes = [f"{samples} draws, and what the fit left: {_left_in_words(left)}"]
    notes += [f"{lost} draws without a motion left out"] if lost else []
    notes += [f"INVALID estimate: {doubt}" for doubt in estimate.doubts]
    notes += [SYNTHETIC] if scene.synthetic else []
    low, high = _band(paths[1:][good[1:]], paths[0], left)
    measured = scene.measured if measured is None else measured
    seen, compared = _seen(measured, paths[0])
    return PredictedMotion(
        scene.name, np.asarray(scene.motion.times), paths[0], low, high, seen, compared, verdict, tuple(notes)
    )


def _left_of(estimate: Estimate) -> Floats:
    """Root mean squares (6,) of what the fit left of each coordinate, in its unit.

    Raises:
        InputError: positions or orientations were not fitted.
    """
    rmse = estimate.rmse
    if missing := {*"XYZ", *TURNS} - rmse.keys():
        found = f"a fit to {', '.join(estimate.channels)}"
        expected = "one to positions and orientations: bands of both are told"
        remedy = "pftwin fit --use position,orientation"
        raise InputError(f"{found}, without {max(missing)}", where="estimate", expected=expected, remedy=remedy)
    return np.array([*(1e3 * rmse[axis] for axis in "XYZ"), *(np.degrees(rmse[n]) for n in list(COORDINATES)[3:])])


def _left_in_words(left: Floats) -> str:
    each = (f"{name} {value:.2g} {unit}" for (name, (unit, _)), value in zip(COORDINATES.items(), left, strict=True))
    return f"{', '.join(each)} (rms)"


def _with_values(
    scene: Scene,
    estimate: Estimate,
    thetas: Floats,
    values: Mapping[str, float | tuple[float, float]],
    random: np.random.Generator,
) -> tuple[Scene, Floats]:
    """The scene, and parameters (n, p), with other values; those between two numbers are drawn evenly."""
    names = list(estimate.names)
    for name, given in values.items():
        low, high = given if isinstance(given, tuple) else (given, given)
        if not (np.isfinite([low, high]).all() and low <= high):
            raise InputError(f"found {low!r} to {high!r}", where=name, expected="a number, or a lower and a higher one")
        if name in names:
            drawn = random.uniform(low, high, len(thetas)) if low < high else np.full(len(thetas), low)
            thetas[:, names.index(name)] = np.concatenate([[0.5 * (low + high)], drawn[1:]])
        elif low < high:
            expected = f"one of: {', '.join(names)}"
            raise InputError("a range of what was not fitted", where=name, expected=expected, remedy="one number")
        else:
            for place in find(scene, name):
                scene = place.written(scene, number(low))
    return scene, thetas


def _coordinates(center: Floats, quaternion: Floats) -> Floats:
    """(..., n, 6) in their units, of centres (..., n, 3) [m] and quaternions (..., n, 4)."""
    angles = patellar_angles(Quaternion(*np.moveaxis(quaternion, -1, 0)))
    turns = np.degrees(np.stack([getattr(angles, name) for name in list(COORDINATES)[3:]], axis=-1))
    return np.concatenate([1e3 * center, turns], axis=-1)


def _beside(path: Floats, values: Floats) -> Floats:
    """The same values (..., n, 6), with angles within half a turn of a path's."""
    off = values - path
    off[..., 3:] = (off[..., 3:] + 180) % 360 - 180
    return path + off


def _band(paths: Floats, path: Floats, left: Floats) -> tuple[Floats, Floats]:
    """Both ends (n, 6) of draws (k, n, 6) beside the estimate's path, each widened by an error; NaN without draws."""
    if not len(paths):
        return np.full_like(path, np.nan), np.full_like(path, np.nan)
    errors = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES)[:, None] * left
    ends = (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
    of_frames = np.moveaxis(_beside(path, paths), 1, 0)
    spread = [np.quantile((a[:, None] + errors).reshape(-1, len(left)), ends, axis=0) for a in of_frames]
    low, high = np.moveaxis(np.array(spread), 1, 0)
    return low, high


def _seen(measured: Measured | None, path: Floats) -> tuple[Floats | None, NDArray[np.bool_]]:
    """What was measured (n, 6), and which frames are compared (n,)."""
    if measured is None:
        return None, np.zeros(len(path), bool)
    turns = np.full((len(path), 4), np.nan) if measured.quaternion is None else measured.quaternion
    seen = _beside(path, _coordinates(measured.center, turns))
    compared = np.asarray(np.isfinite(seen).any(axis=1))
    if measured.weights is not None:
        compared &= measured.weights > 0
    return seen, compared
