"""Predicts the motion of a fitted knee in a recording, with bands, and compares it with the measurements.

A band covers the estimate's uncertainty, by draws, and a normal error added to each draw whose standard deviation is
that of the fit's residuals in the same coordinate. It does not cover what only this recording has, such as another
load.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fitting.estimate import Estimate
from fitting.measured_channels import check_times
from fitting.prediction.plots import MOST_FAILED
from fitting.prediction.predicted_motion import COORDINATES, LEVEL, PredictedMotion
from fitting.prediction.predicting import check_draws, estimate_and_draws, synthetic_parts
from fitting.programs import ORIENTATION, POSITION, TURNS
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import number
from pftwin.base.rotations import patellar_angles
from pftwin.base.spatial import Quaternion
from pftwin.dynamics.batch.simulate_batch import simulate_batch
from pftwin.dynamics.batch.variants import Variants
from pftwin.dynamics.equilibrium_report import Start, invalid_start
from pftwin.dynamics.status import FLAGS, Status
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene, check
from pftwin.model.scene_parameters import find
from pftwin.results.verdict import Verdict, is_invalid, verdict_of_counts

if TYPE_CHECKING:
    from xarray import Dataset

_QUANTILES = 401  # of the normal error that is added to each draw


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
    """Predicts the motion of a fitted knee, with bands for its measurement.

    Args:
        scene: nominal scene with the motion of the recording to predict.
        estimate: estimate of the same knee, from this recording or another.
        measured: measurements at the scene's frames; frames of weight 0 are not compared. By default the scene's own.
        samples: draws from the estimate. Those whose motion or start is INVALID are left out of the bands; if they are
            more than a tenth, the prediction is INVALID.
        seed: of the draws.
        values: parameters of the scene that differ in this recording, by name: a value, or a range (low, high).
        dt: as in `pftwin.simulate_batch`.
        progress: called with the number of motions done and of all.

    Raises:
        InputError: a scene without the estimate's parameters; an estimate without residuals of position and
            orientation; no draws; measurements at other times; values of unknown parameters, of fitted ones by another
            name than the fit's, or out of range.
    """
    check_draws(samples, estimate)
    if samples < 1:
        raise InputError("no draws", where="samples", expected="at least 1: bands are made of them")
    rms = _residual_deviations(estimate)
    thetas = estimate_and_draws(estimate, samples, seed)[:, : estimate.shared]
    measured = scene.measured if measured is None else measured
    if measured is not None:
        check_times(scene, measured)
    scene, thetas = _with_values(scene, estimate, thetas, values or {}, np.random.default_rng([seed, 1]))
    for own in (thetas[0], thetas.min(axis=0), thetas.max(axis=0)) if values else thetas[:1]:
        check(estimate.apply(scene, own))
    found = simulate_batch(Variants(scene, estimate.apply, thetas), dt=dt, trajectories=True, progress=progress)
    good, verdict = _validity(found, scene, estimate, thetas)
    paths = _coordinates(found["sphere_center"].values, found["patella_quaternion"].values)
    lost = int((~good[1:]).sum())
    if verdict == "valid" and lost > MOST_FAILED * samples:
        verdict = f"INVALID: {lost} of {samples} draws have an INVALID motion"
    each = (f"{name} {value:.2g} {unit}" for (name, (unit, _)), value in zip(COORDINATES.items(), rms, strict=True))
    kind = "SD" if estimate.values_compared else "rms"
    notes = [f"{samples} draws, and the residuals of the fit: {', '.join(each)} ({kind})"]
    notes += [f"{lost} draws without a valid motion omitted"] if lost else []
    notes += synthetic_parts(estimate, scene.synthetic or (measured is not None and measured.synthetic))
    low, high = _band(paths[1:][good[1:]], paths[0], rms)
    observed, compared = _measured_path(measured, paths[0])
    ends = (low, high, observed, compared, verdict, tuple(notes), estimate.objection)
    label = "measured" if measured is None else measured.label
    return PredictedMotion(scene.name, np.asarray(scene.motion.times), paths[0], *ends, label)


def _validity(found: Dataset, scene: Scene, estimate: Estimate, thetas: Floats) -> tuple[NDArray[np.bool_], str]:
    """Which motions (n,) and starts of a batch with parameters (n, p) are valid, and the verdict on the first."""
    frames, counts = scene.motion.times.size, found["status_frames"].values
    good = ~(found["failed"].values | is_invalid(counts, frames))
    settled = counts[:, FLAGS.index(Status.START_NOT_IN_EQUILIBRIUM)] == 0
    each_start = zip(settled, found["start_shift"].values, np.radians(found["start_turn"].values), strict=True)
    starts = [
        invalid_start(estimate.apply(scene, theta), Start(*start), explained=k == 0) if k == 0 or good[k] else ()
        for k, (theta, start) in enumerate(zip(thetas, each_start, strict=True))
    ]
    good[1:] &= [not why for why in starts[1:]]
    verdict = Verdict((*verdict_of_counts(counts[0], frames).reasons, *starts[0])).describe()
    return good, "INVALID: the estimate has no motion" if verdict == "valid" and not good[0] else verdict


def _residual_deviations(estimate: Estimate) -> Floats:
    """Standard deviation of the fit's residuals of each coordinate (6,), in its unit: the rms, corrected for the number
    of parameters as in `Objective.noise_of`, if the number of values is known. Raises InputError without residuals."""
    rmse = estimate.rmse
    if missing := {*"XYZ", *TURNS} - rmse.keys():
        if {POSITION, ORIENTATION} <= {*estimate.channels}:
            found, expected = f"no residual of {max(missing)}", "a fit by this version of pftwin or a later one"
            raise InputError(found, where="estimate", expected=expected, remedy="fit again")
        raise InputError(
            f"a fit to {', '.join(estimate.channels)}, without {max(missing)}",
            where="estimate",
            expected="a fit to positions and orientations, since bands of both are predicted",
            remedy="pftwin fit --use position,orientation",
        )
    count = estimate.values_compared
    freedom = np.sqrt(count / max(count - len(estimate.values), 1)) if count else 1.0
    rms = [*(1e3 * rmse[axis] for axis in "XYZ"), *(np.degrees(rmse[n]) for n in list(COORDINATES)[3:])]
    return freedom * np.array(rms)


def _with_values(
    scene: Scene,
    estimate: Estimate,
    thetas: Floats,
    values: Mapping[str, float | tuple[float, float]],
    random: np.random.Generator,
) -> tuple[Scene, Floats]:
    """The scene, and parameters (n, p), with other values; ranges are drawn uniformly."""
    names = estimate.names[: estimate.shared]
    fitted = [find(scene, name)[0] for name in names]
    for name, given in values.items():
        low, high = given if isinstance(given, tuple) else (given, given)
        if not (np.isfinite([low, high]).all() and low <= high):
            raise InputError(f"found {low!r} to {high!r}", where=name, expected="a number, or a lower and a higher one")
        for place in find(scene, name):
            same = [k for k, own in enumerate(fitted) if own.overlaps(place)]
            if any(fitted[k] != place for k in same):
                found, expected = "not as it was fitted", f"the fit's name: {', '.join(names[k] for k in same)}"
                raise InputError(found, where=name, expected=expected)
            if same:
                k = same[0]
                if names[k] in estimate.coordinates:  # applied as an offset from the scene's own coordinate
                    shift = dict(zip(names, estimate.nominal, strict=False))[names[k]] - float(place.read(scene))
                    low, high = low + shift, high + shift
                drawn = random.uniform(low, high, len(thetas)) if low < high else np.full(len(thetas), low)
                thetas[:, k] = np.concatenate([[0.5 * (low + high)], drawn[1:]])
            elif low < high:
                expected = f"one of: {', '.join(names)}"
                raise InputError(
                    "a range for a parameter that was not fitted", where=name, expected=expected, remedy="one number"
                )
            else:
                scene = place.written(scene, number(low))
    return scene, thetas


def _coordinates(center: Floats, quaternion: Floats) -> Floats:
    """Coordinates (..., n, 6) in their units, from centres (..., n, 3) [m] and quaternions (..., n, 4)."""
    angles = patellar_angles(Quaternion(*np.moveaxis(quaternion, -1, 0)))
    turns = np.degrees(np.stack([getattr(angles, name) for name in list(COORDINATES)[3:]], axis=-1))
    return np.concatenate([1e3 * center, turns], axis=-1)


def _unwrapped_near(path: Floats, values: Floats) -> Floats:
    """The same values (..., n, 6), with angles unwrapped to within 180 deg of a path's."""
    off = values - path
    off[..., 3:] = (off[..., 3:] + 180) % 360 - 180
    return path + off


def _band(paths: Floats, path: Floats, rms: Floats) -> tuple[Floats, Floats]:
    """Ends (n, 6) of the band of draws (k, n, 6) about the estimate's path, with the error added; NaN without draws."""
    if not len(paths):
        return np.full_like(path, np.nan), np.full_like(path, np.nan)
    errors = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES)[:, None] * rms
    ends = (0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL)
    of_frames = np.moveaxis(_unwrapped_near(path, paths), 1, 0)
    quantiles = [np.quantile((a[:, None] + errors).reshape(-1, len(rms)), ends, axis=0) for a in of_frames]
    low, high = np.moveaxis(np.array(quantiles), 1, 0)
    return low, high


def _measured_path(measured: Measured | None, path: Floats) -> tuple[Floats | None, NDArray[np.bool_]]:
    """Measured coordinates (n, 6), and which frames are compared (n,)."""
    if measured is None:
        return None, np.zeros(len(path), bool)
    turns = np.full((len(path), 4), np.nan) if measured.quaternion is None else measured.quaternion
    observed = _unwrapped_near(path, _coordinates(measured.center, turns))
    compared = np.asarray(np.isfinite(observed).any(axis=1))
    if measured.weights is not None:
        compared &= measured.weights > 0
    return observed, compared
