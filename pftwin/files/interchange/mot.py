"""OpenSim motion files (.mot): joint coordinates over time, angles in degrees."""

from __future__ import annotations

import os
import warnings
from typing import TYPE_CHECKING

import numpy as np

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.output import check_place
from pftwin.base.text_files import write_text
from pftwin.files.interchange.coordinates import coordinates

if TYPE_CHECKING:
    from xarray import Dataset

_UNITS = (
    "Units are S.I. units (second, meters, Newtons, ...)",
    "Angles are in degrees.",
)


def save_mot(data: Dataset, path: str | os.PathLike[str]) -> None:
    """Writes the motion of tibia and patella in the femur, for OpenSim's models and its tools.

    Frames that are not finite are left out, with a warning.

    Raises:
        InputError: no frame that is finite.
        OutputError: the folder is missing, the path is a folder, or the place cannot be written to.
    """
    times, names, values, rotational = coordinates(finite_frames(data))
    shown = np.where(rotational, np.degrees(values), values)
    head = [
        "Coordinates",
        "version=1",
        f"nRows={times.size}",
        f"nColumns={1 + len(names)}",
        "inDegrees=yes",
        "",
        *_UNITS,
        *([f"Note: {data.attrs['note']}"] if "note" in data.attrs else []),
        "",
        "endheader",
        "\t".join(["time", *names]),
    ]
    lines = ["\t".join(f"{x:.12g}" for x in row) for row in np.column_stack([times, shown])]
    write_text(check_place(path), "\n".join([*head, *lines]) + "\n")


def finite_frames(data: Dataset) -> Dataset:
    """The frames at which patella and tibia have a pose.

    Raises:
        InputError: there is none.
    """
    names = ("patella_position", "patella_quaternion", "tibia_position", "tibia_quaternion")
    finite = np.isfinite(np.concatenate([data[n].values for n in names], axis=1)).all(axis=1)
    if not finite.any():
        raise InputError("no frame with a finite pose", where=data.attrs.get("scene"), remedy="a smaller time step")
    if finite.all():
        return data
    lost = int((~finite).sum())
    warnings.warn(f"{lost} of {finite.size} frames are not finite and are left out", PftwinWarning, stacklevel=2)
    return data.isel(time=np.flatnonzero(finite))
