"""A contact map as an xarray Dataset: units and long names on every variable, what was computed in the attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.studies.contact_map.checks import status
from pftwin.studies.contact_map.mapping import ContactMap

if TYPE_CHECKING:
    from xarray import Dataset


def dataset(found: ContactMap, button: SurfaceMesh, settings: dict[str, Any]) -> Dataset:
    """Everything in SI units, vectors along the femur's axes, the button's mesh with it."""
    from xarray import Dataset

    frame, vector, map_ = ("time",), ("time", "axis"), ("time", "triangle")
    variables = {
        "force": (vector, found.force, _about("N", "contact force on the patella")),
        "moment": (vector, found.moment, _about("N m", "its moment about the origin of the patella's frame")),
        "area": (frame, found.area, _about("m^2", "contact area")),
        "mean_pressure": (frame, found.mean_pressure, _about("Pa", "mean pressure over the contact area")),
        "max_pressure": (frame, found.max_pressure, _about("Pa", "maximum pressure")),
        "center_of_pressure": (vector, found.center_of_pressure, _about("m", "centre of pressure, femur frame")),
        "center_on_patella": (vector, found.center_on_patella, _about("m", "centre of pressure, patella frame")),
        "largest_depth": (frame, found.largest_depth, _about("m", "depth of the deepest triangle")),
        "depth": (map_, found.depth, _about("m", "depth below the femur's surface; missing: farther off")),
        "pressure": (map_, found.pressure, _about("Pa", "pressure on the triangle")),
        "status": (
            frame,
            status(found),
            {
                **_about("1", "reservations; 0: none"),
                "flag_masks": np.array([1, 2], dtype=np.int32),
                "flag_meanings": "no_contact too_deep",
            },
        ),
        "vertex": (("vertex_number", "axis"), button.vertices, _about("m", "button's vertices, patella frame")),
        "face": (("triangle", "corner"), button.faces, _about("1", "vertices of the button's triangles")),
    }
    coordinates = {
        "time": (frame, found.times, _about("s", "time")),
        "axis": (("axis",), ["x", "y", "z"], _about("1", "axes of the frame in question, as in the mesh's file")),
    }
    return Dataset(variables, coordinates, {"title": "contact at given poses", **settings})


def compressed(data: Dataset) -> dict[str, dict[str, Any]]:
    """How the maps are written: most of them are empty."""
    return {name: {"zlib": True, "complevel": 4} for name in ("depth", "pressure") if name in data}


def _about(unit: str, long_name: str) -> dict[str, str]:
    return {"units": unit, "long_name": long_name}
