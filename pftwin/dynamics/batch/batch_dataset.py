"""The result of a batch as an xarray Dataset: outcomes of each variant with units, and status flags."""

from __future__ import annotations

from functools import reduce
from operator import getitem
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy.typing import NDArray

from pftwin.base.quantities import about
from pftwin.base.text_files import shortened_list
from pftwin.dynamics.batch.plan import WAYS, Found
from pftwin.dynamics.batch.variants import Group
from pftwin.dynamics.status import FLAGS, Status

if TYPE_CHECKING:
    from xarray import Dataset

SUMMARY = {  # unit, meaning
    "mean_tilt": ("deg", "mean patellar tilt, lateral positive"),
    "largest_tilt": ("deg", "largest patellar tilt, lateral positive"),
    "mean_shift": ("m", "mean lateral place of the tracked point in the femur frame"),
    "largest_shift": ("m", "most lateral place of the tracked point in the femur frame"),
    "last_proximal": ("m", "tracked point at the last frame, femur frame: proximal"),
    "last_lateral": ("m", "tracked point at the last frame, femur frame: lateral"),
    "last_anterior": ("m", "tracked point at the last frame, femur frame: anterior"),
    "largest_contact_force": ("N", "largest contact force of the button"),
    "mean_contact_force": ("N", "mean contact force of the button"),
    "estimated_error_path": ("m", "estimated error of the steps, largest of all frames: points near the tracked one"),
    "estimated_error_contact_force": ("N", "estimated error of the steps, largest of all frames: contact force"),
    "estimated_error_medial_facet": ("N", "estimated error of the steps, largest: force on the medial facet"),
    "estimated_error_lateral_facet": ("N", "estimated error of the steps, largest: force on the lateral facet"),
}
COURSES = {
    "sphere_center": ("axis", "m", "tracked point in the femur frame"),
    "patella_position": ("axis", "m", "patella's origin in the femur frame"),
    "patella_quaternion": ("component", "1", "orientation of the patella in the femur frame, unit quaternion"),
    "frame_status": (None, "1", "how far the frame can be trusted; 0: no reservation"),
}
STARTS = {
    "equilibrium_residual": ("N", "residual force of the equilibrium that the motion starts from"),
    "start_shift": ("m", "distance of the equilibrium's centre of mass from the scene's start pose"),
    "start_turn": ("deg", "rotation of the equilibrium from the scene's start pose"),
}
OWN_NAMES = {*SUMMARY, *COURSES, *STARTS, "status", "status_frames", "recomputed", "failed"}
COORDINATES = ("variant", "scene", "flag", "values", "number", "time", "axis", "component")
_VOID = (Status.NOT_FINITE, Status.START_NOT_IN_EQUILIBRIUM)
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]


def dataset(groups: list[Group], parts: list[Found], values: Any, settings: dict[str, Any]) -> Dataset:
    """Dataset of all variants, or some, in the order given; `parts` are the results of each group."""
    from xarray import Dataset

    from pftwin import __version__

    order = np.argsort(np.concatenate([g.places for g in groups]))
    names = np.array([name for g in groups for name in g.names])[order]

    def gathered(*path: str) -> NDArray[Any]:
        found: list[Any] = [reduce(getitem, path, part) for part in parts]
        return np.concatenate(found)[order]

    frames = gathered("status_frames")
    status = ((frames > 0) @ np.array([int(f) for f in FLAGS])).astype(np.int32)
    failed = ~gathered("sensible") | (status & sum(int(f) for f in _VOID) > 0)
    variables: Variables = {}

    def known(values: NDArray[Any]) -> NDArray[Any]:
        """The values with NaN for failed variants, if their type has NaN."""
        if not np.issubdtype(values.dtype, np.inexact):
            return values
        return np.where(failed.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)

    for name in [n for n in SUMMARY if all(n in part["summary"] for part in parts)]:
        unit, words = SUMMARY[name]
        variables[name] = (("variant",), known(_in_unit(gathered("summary", name), unit)), about(unit, words))
    for name in parts[0]["own"]:
        own = gathered("own", name)
        dimensions = ("variant", *(f"{name}_{i}" for i in range(own.ndim - 1)))
        variables[name] = (dimensions, known(own), {"long_name": name.replace("_", " ")})
    variables |= _trust(gathered, frames, status, failed)
    for name in parts[0]["courses"]:
        last, unit, words = COURSES[name]
        variables[name] = (
            ("variant", "time", *([last] if last else [])),
            known(gathered("courses", name)),
            about(unit, words),
        )
    attributes = {"source": f"pftwin {__version__}", "jax_version": jax.__version__, **settings}
    found = Dataset(variables, _coordinates(groups, parts, order, names, values), attributes)
    return found.assign_attrs(summed_up(found))


def summed_up(found: Dataset) -> dict[str, Any]:
    """Attributes of a batch's dataset that count variants."""
    names = list(dict.fromkeys(found["scene"].values.tolist()))
    recomputed = found["recomputed"].values
    return {
        "title": f"batch of {len(recomputed)}: {shortened_list(names, 3)}",
        "recomputed_members": int((recomputed > 0).sum()),
        "recomputed_in_vain": int((recomputed == WAYS.index("in_vain")).sum()),
    }


def _in_unit(values: NDArray[Any], unit: str) -> NDArray[Any]:
    """The values, from radians if the unit is degrees."""
    return np.degrees(values) if unit == "deg" else values


def _trust(gathered: Any, frames: NDArray[Any], status: NDArray[Any], failed: NDArray[Any]) -> Variables:
    masks = {
        "flag_masks": np.array([int(f) for f in FLAGS], dtype=np.int32),
        "flag_meanings": " ".join(str(f.name).lower() for f in FLAGS),
        "flag_descriptions": [f.describe() for f in FLAGS],
    }
    ways = {"flag_values": np.arange(len(WAYS), dtype=np.int8), "flag_meanings": " ".join(WAYS)}
    why = "no equilibrium to start from, not finite, or an invalid parameter"
    return {
        "status": (("variant",), status, {**about("1", "flags that are raised in any frame; 0: none"), **masks}),
        "status_frames": (("variant", "flag"), frames, about("1", "recorded frames with each status")),
        "recomputed": (("variant",), gathered("recomputed"), {**about("1", "whether and how recomputed"), **ways}),
        "failed": (("variant",), failed, about("1", why)),
        **{n: (("variant",), _in_unit(gathered(n), unit), about(unit, words)) for n, (unit, words) in STARTS.items()},
    }


def _coordinates(
    groups: list[Group], parts: list[Found], order: NDArray[np.int64], names: NDArray[np.str_], values: Any
) -> Variables:
    variants = np.concatenate([g.places for g in groups])[order]
    out: Variables = {
        "variant": (("variant",), variants, about("1", "member of the batch")),
        "scene": (("variant",), names, {"long_name": "scene"}),
        "flag": (("flag",), [str(f.name).lower() for f in FLAGS], {"long_name": "status flag"}),
    }
    if values is not None:
        given = np.asarray(values, float)[variants]
        out["values"] = (("variant", "number"), given, {"long_name": "numbers given to the change"})
    if parts[0]["courses"]:
        axis = {"long_name": "femur axis: x proximal, y lateral, z anterior", "units": "1"}
        out["time"] = (("time",), groups[0].scene.motion.times, about("s", "time"))
        out["axis"] = (("axis",), ["x", "y", "z"], axis)
        out["component"] = (("component",), list("wxyz"), about("1", "quaternion component"))
    return out
