"""Conversion of a result to an xarray Dataset with units, long names and provenance attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from pftwin.base.quantities import about, netcdf_attribute
from pftwin.dynamics.status import FLAGS
from pftwin.model.effects.base import Observable
from pftwin.model.measured import SYNTHETIC

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result

_AXES = ("x", "y", "z")
_COMPONENTS = ("w", "x", "y", "z")
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]


def dataset(result: Result) -> Dataset:
    """Returns the dataset of a result: angles in degrees, everything else in SI units."""
    from xarray import Dataset

    variables: Variables = {**_kinematics(result), **_tracking(result)}
    for name, report in result.effects.items():
        for key, values in report.items():
            described = result.observables[name].get(key, Observable("1", key.replace("_", " ")))
            attributes = about(described.unit, f"{name.replace('_', ' ')}: {described.long_name}")
            variables[f"{name}_{key}"] = (_dimensions(result, name, values), values, attributes)
    variables |= {**_energies(result), **_errors(result)}
    status = {
        **about("1", "how far the frame can be trusted; 0: no reservation"),
        "flag_masks": np.array([int(f) for f in FLAGS], dtype=np.int32),
        "flag_meanings": " ".join(str(f.name).lower() for f in FLAGS),
        "flag_descriptions": [f.describe() for f in FLAGS],
    }
    variables["status"] = (("time",), result.flags, status)
    coordinates = {
        "time": (("time",), result.times, about("s", "time")),
        "axis": (("axis",), list(_AXES), {"long_name": "femur axis: x proximal, y lateral, z anterior", "units": "1"}),
        "component": (("component",), list(_COMPONENTS), {"long_name": "quaternion component", "units": "1"}),
    }
    return Dataset(variables, coordinates, attributes_of(result))


def attributes_of(result: Result) -> dict[str, Any]:
    """Returns the dataset's attributes: software versions, settings, equilibrium, status, verdict and timing."""
    from pftwin import __version__

    start = result.equilibrium
    attributes = {
        "title": f"patellofemoral tracking: {result.scene_name}",
        "scene": result.scene_name,
        "side": "left" if result.scene.left else "right",
        "source": f"pftwin {__version__}",
        "pftwin_version": __version__,
        "jax_version": jax.__version__,
        "dtype": result.dtype,
        "status": result.status.describe(),
        "equilibrium": start.description,
        "equilibrium_kind": start.kind,
        "equilibrium_converged": int(start.converged),
        "equilibrium_residual_N": start.residual,
        "equilibrium_iterations": start.iterations,
        "equilibrium_relaxed": int(start.relaxed),
        "equilibrium_smallest_stiffness_N_per_m": float(start.eigenvalues[0]),
        "equilibrium_facets": " ".join(start.facets) or "none",
        "equilibrium_moved_mm": 1e3 * start.moved,
        "equilibrium_turned_deg": float(np.degrees(start.turned)),
        "largest_indentation_m": result.largest_indentation,
        "real_time_factor": result.real_time_factor,
        "verdict": result.verdict.describe(),
        "tracking": result.tracking,
    }
    if result.scene.synthetic:
        attributes["note"] = SYNTHETIC
    if result.impact is not None:
        attributes["restitution"] = result.impact.describe()
    if result.constraint_drift is not None:
        attributes["largest_constraint_drift_m"] = result.constraint_drift
    settings = {k: netcdf_attribute(v) for k, v in result.settings.items()}
    return {**attributes, **settings, **{f"timing_{k}": float(v) for k, v in result.timing.items()}}


def _kinematics(result: Result) -> Variables:
    angles, knee, (place, turn) = result.angles, result.knee, result.tibia
    tracked = "patella's origin" if result.contact is None else "button's sphere centre"
    grood = "(Grood and Suntay 1983)"
    rows = {
        "sphere_center": (result.center, "m", f"{tracked} in the femur frame"),
        "patella_position": (result.position, "m", "patella's origin in the femur frame"),
        "patella_quaternion": (
            result.quaternion, "1", "orientation of the patella in the femur frame, unit quaternion (w, x, y, z)"
        ),
        "tibia_position": (place, "m", "origin of the tibia's frame in the femur's"),
        "tibia_quaternion": (turn, "1", "orientation of the tibia in the femur frame, unit quaternion (w, x, y, z)"),
        "patella_shift": (result.shift, "m", f"{tracked}: lateral place in the femur frame"),
        "patella_flexion": (angles.flexion, "deg", "patellar flexion about the femur's medial-lateral axis"),
        "patella_tilt": (angles.tilt, "deg", "patellar tilt about its long axis, lateral positive"),
        "patella_rotation": (
            angles.rotation, "deg", "patellar rotation about the floating axis, internal (medial) positive"
        ),
        "knee_flexion": (knee.flexion, "deg", f"knee flexion {grood}"),
        "knee_adduction": (knee.adduction, "deg", f"knee adduction {grood}"),
        "knee_internal_rotation": (knee.internal_rotation, "deg", f"internal rotation of the tibia {grood}"),
    }  # fmt: skip
    return {name: _row(*row) for name, row in rows.items()}


def _row(values: Any, unit: str, long_name: str) -> tuple[tuple[str, ...], Any, dict[str, str]]:
    """A per-frame variable of scalars, vectors or quaternions; converts angles from radians to degrees."""
    values = np.degrees(values) if unit == "deg" else np.asarray(values)
    last = {1: (), 3: ("axis",), 4: ("component",)}[values.shape[1] if values.ndim == 2 else 1]
    return ("time", *last), values, about(unit, long_name)


def _tracking(result: Result) -> Variables:
    if result.groove is None:
        return {}
    place, offset = result.groove
    found = {
        "groove_position": _row(place, "m", "place of the sphere centre along the groove"),
        "groove_offset": _row(offset, "m", "sphere centre off the groove's bottom, lateral positive"),
    }
    outcome = result.dislocations()
    if outcome is None:  # the motion is not valid
        return found
    out = outcome.dislocated.astype(np.int8)
    dimensions, out, attributes = _row(out, "1", "whether the button has left the groove")
    flags = {"flag_values": np.array([0, 1], dtype=np.int8), "flag_meanings": "in_the_groove dislocated"}
    return {**found, "dislocated": (dimensions, out, {**attributes, **flags})}


def _energies(result: Result) -> Variables:
    e = result.energies
    found: dict[str, tuple[Any, str]] = {"kinetic_energy": (e.kinetic, "kinetic energy of the patella")}
    for name, values in e.stored.items():
        found[f"stored_energy_{name}"] = (values, f"energy stored by {name.replace('_', ' ')}")
    found["total_energy"] = (e.total, "kinetic and stored energy")
    taken = "energy that the integrator's steps removed since the start; negative: added"
    found |= {
        "work": (e.work, "work of the guided bodies and of known pulls since the start"),
        "heat": (e.heat, "energy lost in damping since the start"),
        "numerical_dissipation": (e.numerical_dissipation, taken),
        "energy_budget_error": (e.budget_error, "energy that is left over: the error of the account itself"),
    }
    return {name: _row(values, "J", text) for name, (values, text) in found.items() if values is not None}


def _errors(result: Result) -> Variables:
    if result.error is None:
        return {}
    rows = {
        "path": ("m", "patella's points within 20 mm of the tracked one"),
        "contact_force": ("N", "contact force, length of the difference"),
        "medial_facet": ("N", "force on the medial facet"),
        "lateral_facet": ("N", "force on the lateral facet"),
    }
    return {
        f"estimated_error_{name}": _row(getattr(result.error, name), unit, f"estimated error of the steps: {text}")
        for name, (unit, text) in rows.items()
    }


def _dimensions(result: Result, effect: str, values: np.ndarray) -> tuple[str, ...]:
    """Dimension names: a group's elements have their own dimension, and a last axis of three is x, y, z."""
    rest, names = values.shape[1:], ["time"]
    if rest and rest[0] == result.groups.get(effect):
        rest, names = rest[1:], ["time", f"{effect}_element"]
    for i, size in enumerate(rest):
        last = i == len(rest) - 1
        names.append("axis" if last and size == len(_AXES) else f"{effect}_{i}_{size}")
    return tuple(names)
