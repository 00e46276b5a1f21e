"""A prediction as an xarray Dataset: amounts as coordinates, outcomes with units, and how far to trust each member."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting.prediction.members import Members
from fitting.prediction.outcomes import MEASURES
from fitting.prediction.variants import VariantBatch
from pftwin.dynamics.batch.member import FLAGS
from pftwin.dynamics.status import Status
from pftwin.model.measured import SYNTHETIC

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.prediction.predicting import Fitted

Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]
_DEGREES = 180 / np.pi
_COURSES = {
    "sphere_center": ("m", "button's sphere centre in the femur frame"),
    "groove_offset": ("m", "sphere centre off the groove's bottom, lateral positive"),
    "patella_tilt": ("rad", "patellar tilt, lateral positive"),
    "force_medial": ("N", "normal force on the medial facet"),
    "force_lateral": ("N", "normal force on the lateral facet"),
}
_TROUBLE = (Status.NOT_FINITE, Status.START_NOT_IN_EQUILIBRIUM)  # what makes a member's outcomes void


def dataset(
    batches: list[VariantBatch],
    found: list[Members],
    estimate: Fitted | None,
    thetas: NDArray[np.float64],
    **settings: float,
) -> Dataset:
    """The dataset of members, which stand batch by batch, variants by samples."""
    from xarray import Dataset

    places = np.concatenate([b.places for b in batches])
    order, many = np.argsort(places), len(thetas)
    sampled = many > 1
    axes = ("variant", "sample") if sampled else ("variant",)

    def gathered(parts: list[Any]) -> Any:
        a = np.concatenate([p.reshape(len(b.places), many, *p.shape[1:]) for b, p in zip(batches, parts, strict=True)])
        return a[order] if sampled else a[order][:, 0]

    flags = gathered([m.flags for m in found])
    failed = ~gathered([m.sensible for m in found]) | (flags[..., [FLAGS.index(f) for f in _TROUBLE]] > 0).any(axis=-1)
    variables: Variables = {}
    for name, about in MEASURES.items():
        values, unit = _shown(gathered([m.outcomes[name] for m in found]), about.unit)
        values = np.where(failed, np.nan, values)
        variables[name] = (axes, values, {"units": unit, "long_name": about.long_name})
    variables["failed"] = (axes, failed, {"units": "1", "long_name": "no equilibrium to start from, or not finite"})
    meaning = {"units": "1", "long_name": "recorded frames with each status", "flags": [f.describe() for f in FLAGS]}
    variables["status_frames"] = ((*axes, "flag"), flags, meaning)
    for name in found[0].courses:
        values, unit = _shown(gathered([m.courses[name] for m in found]), _COURSES[name][0])
        last = ("axis",) if name == "sphere_center" else ()
        variables[name] = ((*axes, "time", *last), values, {"units": unit, "long_name": _COURSES[name][1]})
    coordinates = _coordinates(batches, order, len(places), bool(found[0].courses))
    if estimate is not None:
        parameters = thetas if sampled else thetas[0]
        coordinates["parameter"] = (("parameter",), list(estimate.names), {"long_name": "estimated parameter"})
        coordinates["parameter_unit"] = (("parameter",), list(estimate.units), {"long_name": "its unit"})
        about = {"units": "as parameter_unit", "long_name": "values that were used"}
        variables["parameters"] = ((*(("sample",) if sampled else ()), "parameter"), parameters, about)
    if sampled:
        coordinates["sample"] = (
            ("sample",),
            np.arange(many),
            {"long_name": "0: the estimate; then draws", "units": "1"},
        )
    return Dataset(variables, coordinates, _attributes(batches, estimate, settings))


def _coordinates(batches: list[VariantBatch], order: NDArray[np.int64], count: int, timed: bool) -> Variables:
    """The variant axis: number, scene, words, and each amount; 0 where a variant's treatment has no such amount."""
    words, scenes = [], []
    amounts: dict[str, tuple[NDArray[np.float64], str]] = {}
    first = 0
    for batch in batches:
        rows = slice(first, first + len(batch.places))
        first = rows.stop
        words += [batch.treatment.with_values(row).describe() for row in batch.amounts]
        scenes += [batch.scene.name] * len(batch.places)
        named = zip(batch.treatment.names, batch.treatment.ways, batch.amounts.T, strict=True)
        for name, way, column in named:
            values, unit = _shown(column, way.unit)
            amounts.setdefault(name.replace(".", "_"), (np.zeros(count), unit))[0][rows] = values
    out: Variables = {
        "variant": (("variant",), np.arange(count), {"units": "1", "long_name": "variant"}),
        "scene": (("variant",), np.array(scenes)[order], {"long_name": "scene"}),
        "treatment": (("variant",), np.array(words)[order], {"long_name": "treatment"}),
        "flag": (("flag",), [str(f.name).lower() for f in FLAGS], {"long_name": "status flag"}),
    }
    for name, (values, unit) in amounts.items():
        long_name = name.replace("_", " ")
        out[name] = (("variant",), values[order], {"units": unit, "long_name": long_name})
    if timed:
        motion = batches[0].scene.motion
        out["time"] = (("time",), motion.times, {"units": "s", "long_name": "time"})
        axis = {"long_name": "femur axis: x proximal, y lateral, z anterior", "units": "1"}
        out["axis"] = (("axis",), ["x", "y", "z"], axis)
    return out


def _shown(values: NDArray[Any], unit: str) -> tuple[NDArray[Any], str]:
    """Angles in degrees, all else as it is."""
    return (_DEGREES * values, "deg") if unit == "rad" else (values, unit)


def _attributes(batches: list[VariantBatch], estimate: Fitted | None, settings: dict[str, float]) -> dict[str, Any]:
    import jax

    from pftwin import __version__

    names = list(dict.fromkeys(b.scene.name for b in batches))
    synthetic = bool(getattr(estimate, "synthetic", False))
    source = getattr(estimate, "source", "")
    said = [SYNTHETIC] if any(b.scene.synthetic for b in batches) else []
    said += ["the parameters were estimated from synthetic measurements"] if synthetic else []
    return {
        "title": f"predicted outcomes: {', '.join(names)}",
        "source": f"pftwin {__version__}",
        "jax_version": jax.__version__,
        "parameters": "of the scene" if estimate is None else f"estimated from {source or 'measurements'}",
        "synthetic": int(synthetic),
        **({"note": "; ".join(said)} if said else {}),
        **{k: float(v) for k, v in settings.items()},
    }
