"""Errors of a simulation against measurements: the rows of Table 1 in Michaud et al. 2024."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import annotated, as_read
from pftwin.model.effects.base import Reported
from pftwin.model.measured import Measured
from pftwin.results.skin_markers import QUALITATIVE, Reading, SkinMarker

if TYPE_CHECKING:
    from pftwin.results.result import Result

_SAME_TIME = 0.1  # tolerance of times as a share of the frame interval, because files hold rounded times
_UNLIKE = 3.0  # ratio of two forces' sizes (rms) beyond which the unit is doubtful: a pound-force is 4.4 N
_LOADED = 0.5  # largest simulated force [N] from which on sizes are compared, in frames
_SHARE = 0.05  # with at least such a share of the largest simulated and of the largest measured force
_NEARER = 2.0  # times by which two springs' forces fit better exchanged, from which on their channels are doubtful
_FAR = 30.0  # distance of the sphere's centres at every frame beyond which unit, axes or frame are doubtful [mm]


class ValidationRow(NamedTuple):
    """One row of the validation table."""

    key: str  # field of `Validation`
    label: str
    unit: str
    value: float | None  # None: not measured
    paper: float | None  # value in the paper's table


@dataclass(frozen=True)
class Validation:
    """Root mean square errors of forces, angles and positions, mean distance and timing, with label and unit of each.

    None: not measured. Errors are NaN if the simulation has frames that are not finite.
    """

    contact_force: Annotated[float | None, "contact force RMSE", "N"]
    tibial_spring: Annotated[float | None, "tibial spring RMSE", "N"]
    femoral_spring: Annotated[float | None, "femoral spring RMSE", "N"]
    internal_rotation: Annotated[float | None, "internal rotation RMSE", "deg"]
    flexion: Annotated[float | None, "flexion RMSE", "deg"]
    tilt: Annotated[float | None, "tilt RMSE", "deg"]
    x: Annotated[float | None, "X RMSE", "mm"]
    y: Annotated[float | None, "Y RMSE", "mm"]
    z: Annotated[float | None, "Z RMSE", "mm"]
    mean_distance: Annotated[float | None, "mean distance", "mm"]  # of the simulated from the measured sphere centre
    initial_configuration: Annotated[float | None, "initial configuration", "s"]  # search for the starting equilibrium
    real_time_factor: Annotated[float | None, "faster than real time", "x"]  # from `run_s` of the result's timing
    frames: int
    frames_compared: int  # frames with a measured position
    scene: str = ""
    synthetic: bool = False  # whether the measurements are synthetic
    readings: tuple[ValidationRow, ...] = ()  # other observables of effects that were measured
    skin_markers: tuple[SkinMarker, ...] = ()  # skin markers, whose absolute position is not compared
    doubts: tuple[str, ...] = ()  # measurements that look as if they had another unit, sign, frame or channel

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values that can be written as JSON."""
        skin = [{**row._asdict(), "note": QUALITATIVE} for row in self.skin_markers]
        return {
            **asdict(self),
            "readings": {row.key: {"rmse": row.value, "unit": row.unit} for row in self.readings},
            "skin_markers": {row.pop("key"): row for row in skin},
        }

    def to_rows(self, paper: str | None = None) -> list[ValidationRow]:
        """Returns the table's rows, with the values of a column of the paper ("CM", "FM", "P2", "P4", "P5") if named.

        Raises:
            InputError: the paper has no such column.
        """
        if paper is not None and paper not in PAPER_TABLE_1:
            known = f"one of: {', '.join(PAPER_TABLE_1)}"
            raise InputError(f"no column {paper!r} in the paper's Table 1", expected=known)
        column = PAPER_TABLE_1[paper] if paper else {}
        rows = [ValidationRow(k, label, unit, getattr(self, k), column.get(k)) for k, (label, unit) in _ROWS.items()]
        return [*rows, *self.readings]


_ROWS = annotated(Validation)  # label and unit of each row
# In the order of the paper's table, which need not be that of the fields.
_PAPER_ROWS = (
    "contact_force", "tibial_spring", "femoral_spring", "internal_rotation", "flexion", "tilt", "x", "y", "z",
    "mean_distance", "initial_configuration", "real_time_factor",
)  # fmt: skip
_PAPER = {
    "CM": (4.90, 1.52, 1.96, 3.72, 2.47, 11.38, 2.36, 2.16, 2.20, 2.98, 2.37, 0.19),
    "FM": (3.44, 1.39, 2.01, 0.65, 1.49, 4.85, 2.02, 2.10, 2.10, 2.78, 33.29, 0.07),
    "P2": (4.06, 3.45, 2.27, 0.45, 1.82, 4.46, 4.53, 3.67, 5.81, 7.25, 0.51, 6.00),
    "P4": (3.38, 1.30, 1.96, 0.74, 1.66, 6.60, 2.71, 1.88, 2.70, 2.99, 0.63, 4.97),
    "P5": (3.33, 0.89, 2.15, 0.59, 1.38, 4.45, 1.44, 1.36, 1.70, 2.30, 0.72, 4.55),
}
# Michaud et al. 2024, Table 1: means over the four cases, by contact model and field of `Validation`.
PAPER_TABLE_1: dict[str, dict[str, float]] = {
    model: dict(zip(_PAPER_ROWS, row, strict=True)) for model, row in _PAPER.items()
}


def validate(
    result: Result,
    measured: Measured,
    *,
    tibial: str | None = "patellar_tendon",
    femoral: str | None = "quadriceps",
) -> Validation:
    """Compares a simulation with measurements of the same motion, frame by frame.

    Args:
        result: the simulation.
        measured: measurements at the same frames.
        tibial: effect whose tension corresponds to the measured tibial spring force; None omits the row.
        femoral: the same for the femoral spring.

    Raises:
        InputError: the times differ from the simulation's (number, rate or start); no frame has a measured position
            and there is no skin marker; a force or reading belongs to an effect that the scene does not have.
    """
    _check_times(result, measured)
    contact = _forces(result, result.contact, "force", measured.contact_force, measured)
    tibia = _forces(result, tibial, "tension", measured.tibial_spring_force, measured)
    femur = _forces(result, femoral, "tension", measured.femoral_spring_force, measured)
    offsets = 1e3 * (result.center - measured.center)
    present = np.asarray(np.isfinite(measured.center).all(axis=1))
    placed = bool(present.any())
    if not (placed or measured.skin_markers):
        raise InputError("no frame has a measured position", where=measured.source, expected="at least one")
    distances = np.linalg.norm(offsets[present], axis=1)
    forces = {"contact force": contact, "tibial spring": tibia, "femoral spring": femur}
    skin = [name for name in measured.readings if name.rpartition(".")[0] in measured.skin_markers]
    return Validation(
        contact_force=_force_error(contact),
        tibial_spring=_force_error(tibia),
        femoral_spring=_force_error(femur),
        internal_rotation=_angle_error(result, measured, "rotation"),
        flexion=_angle_error(result, measured, "flexion"),
        tilt=_angle_error(result, measured, "tilt"),
        **{axis: _rms(offsets[:, i], present) if placed else None for i, axis in enumerate("xyz")},
        mean_distance=float(np.mean(distances)) if placed else None,
        initial_configuration=result.timing.get("equilibrium_s"),
        real_time_factor=result.real_time_factor if "run_s" in result.timing else None,
        frames=result.times.size,
        frames_compared=int(np.count_nonzero(present)),
        scene=result.scene_name,
        synthetic=measured.synthetic,
        readings=tuple(_reading_error(result, *of) for of in measured.readings.items() if of[0] not in skin),
        skin_markers=tuple(SkinMarker.of(n, reading(result, n), measured.readings[n], measured.source) for n in skin),
        doubts=tuple(_doubts(forces, distances)) if result.verdict.valid else (),
    )


def _reading_error(result: Result, name: str, measured: Floats) -> ValidationRow:
    simulated, present = reading(result, name), np.isfinite(measured)
    error = _rms(simulated.values - simulated.scale * measured, present) if present.any() else None
    return ValidationRow(name, f"{name} RMSE", simulated.unit, error, None)


def reading(result: Result, name: str) -> Reading:
    """Returns the observable "EFFECT.OBSERVABLE"; InputError if it is unknown or has several numbers per frame."""
    reported = Reported.of(name, result.observables, result.scene_name)
    values = np.asarray(result.effects[reported.effect][reported.key], dtype=np.float64)
    if values.ndim != 1:
        expected = "one number a frame, as a measurement has"
        raise InputError(f"{name} has {values[0].size} numbers a frame", where=result.scene_name, expected=expected)
    scale, unit = as_read(reported.unit)
    return Reading(scale * values, scale, unit, reported.long_name)


def mean_of(validations: Sequence[Validation]) -> Validation:
    """Averages validations over cases; a row that a case lacks is None, readings are omitted. InputError if empty."""
    if not validations:
        raise InputError("no validations to take the mean of", where="validations", expected="at least one")
    columns = {key: [getattr(v, key) for v in validations] for key in _ROWS}
    means: dict[str, Any] = {k: None if None in values else float(np.mean(values)) for k, values in columns.items()}
    return Validation(
        **means,
        frames=sum(v.frames for v in validations),
        frames_compared=sum(v.frames_compared for v in validations),
        scene=f"mean of {len(validations)}",
        synthetic=any(v.synthetic for v in validations),
        doubts=tuple(f"{v.scene}: {doubt}" for v in validations for doubt in v.doubts),
    )


def _check_times(result: Result, measured: Measured) -> None:
    ours, theirs, where = result.times, measured.times, measured.source
    if theirs.size != ours.size:
        rates = [(t.size - 1) / (t[-1] - t[0]) if t.size > 1 else 0.0 for t in (theirs, ours)]
        raise InputError(
            f"{theirs.size} frames at {rates[0]:.4g} Hz",
            where=where,
            expected=f"the simulation's {ours.size} frames at {rates[1]:.4g} Hz",
            remedy="the measurements of the motion that was simulated, resampled at its frames",
        )
    off = np.abs(theirs - ours)
    tolerance = _SAME_TIME * (ours[-1] - ours[0]) / (ours.size - 1)
    if (bad := np.flatnonzero(off > tolerance)).size:
        i = int(bad[0])
        raise InputError(
            f"frame {i + 1} was measured at {theirs[i]:.6g} s",
            where=where,
            expected=f"{ours[i]:.6g} s as in the simulation, to within {1e3 * tolerance:.3g} ms",
            remedy="measurements with the simulated motion's clock and rate",
        )


def _forces(
    result: Result, effect: str | None, observable: str, force: Floats | None, measured: Measured
) -> tuple[Floats, Floats] | None:
    """A simulated and the measured force at every frame, NaN where not measured [N]; None if it never was."""
    if force is None or (effect is None and observable != "force"):
        return None
    if effect is None or observable not in result.effects.get(effect, {}):
        wanted = "a contact" if effect is None else f"an effect {effect!r} with a {observable}"
        raise InputError(
            f"{measured.source} has a force of {wanted}, which this scene lacks",
            where=result.scene_name,
            expected=f"one of: {', '.join(result.effects)}",
            remedy="name the effect (tibial=..., femoral=...), or leave the force out",
        )
    return (summed(result.effects[effect][observable]), force) if np.isfinite(force).any() else None


def _force_error(forces: tuple[Floats, Floats] | None) -> float | None:
    return None if forces is None else _rms(forces[0] - forces[1], np.isfinite(forces[1]))


def _doubts(forces: Mapping[str, tuple[Floats, Floats] | None], distances: Floats) -> Iterator[str]:
    """What is wrong with measurements, if a sound simulation differs from them by more than models do."""
    if distances.size and (near := float(distances.min())) > _FAR:
        yield f"the measured centre is {near:.3g} mm or more from the simulated one: check its unit, axes and frame"
    if _exchanged(forces["tibial spring"], forces["femoral spring"]):
        yield "the measured tibial and femoral spring look exchanged: check their channels"
    for name, pair in forces.items():
        if pair is None:
            continue
        pair = [each[np.isfinite(pair[1])] for each in pair]
        if not np.abs(pair[0]).max() >= _LOADED:
            continue
        loaded = [np.abs(each) > _SHARE * np.abs(each).max() for each in pair]
        if not (both := loaded[0] & loaded[1]).any():
            continue
        ours, theirs = (each[both] for each in pair)
        if max(_size(ours), _size(theirs)) > _UNLIKE * min(_size(ours), _size(theirs)):
            sizes = f"{_size(theirs):.3g} N rms, the simulated one {_size(ours):.3g} N"
            yield f"the measured {name} has {sizes}: check its unit and channel"
        elif np.mean(theirs) < 0:
            yield f"the measured {name} is negative: check its sign"


def _exchanged(one: tuple[Floats, Floats] | None, other: tuple[Floats, Floats] | None) -> bool:
    """Whether two measured forces are much nearer to the simulated ones if they are exchanged."""
    if one is None or other is None or not (both := np.isfinite(one[1]) & np.isfinite(other[1])).any():
        return False
    ours, theirs = (np.stack(pair, axis=1)[both] for pair in zip(one, other, strict=True))
    if np.abs(ours).max(axis=0).min() < _LOADED:
        return False
    straight, exchanged = (float(up_to_scale(each, ours[None])[0]) for each in (theirs, theirs[:, ::-1]))
    return straight > _NEARER * exchanged


def up_to_scale(data: Floats, model: Floats) -> Floats:
    """Distances (N,) of two forces (n, 2) from those of N motions (N, n, 2), as shares of these, up to a common scale,
    which equilibrium leaves open."""
    size = np.maximum(np.sqrt(np.mean(model**2, axis=1, keepdims=True)), 1e-300)
    a, b = (data / size).reshape(len(model), -1), (model / size).reshape(len(model), -1)
    scale = np.maximum(np.sum(a * b, axis=1) / np.maximum(np.sum(a * a, axis=1), 1e-300), 0.0)
    return np.sqrt(np.mean((scale[:, None] * a - b) ** 2, axis=1))


def summed(values: NDArray[Any]) -> Floats:
    """Sums an observable (n, ...) over the elements of its group: (n,)."""
    return np.asarray(values, dtype=np.float64).reshape(len(values), -1).sum(axis=1)


def _rms(error: Floats, present: NDArray[np.bool_]) -> float:
    """Root mean square error over the measured frames."""
    return _size(error[present])


def _size(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def _angle_error(result: Result, measured: Measured, name: str) -> float | None:
    """Root mean square error of an angle [deg]; None if no frame was measured."""
    if measured.angles is None or not np.isfinite(theirs := getattr(measured.angles, name)).any():
        return None
    error = (getattr(result.angles, name) - theirs + np.pi) % (2 * np.pi) - np.pi
    return _rms(np.degrees(error), np.isfinite(theirs))
