"""A result's file in another program's format, chosen by the suffix; OpenSim's motion files (.mot) are written here.

Joint coordinates have the names and sequence of the models of OpenSim JAM (Lenhart et al. 2015, Ann Biomed Eng
43:2675): tibia and patella each move in the femur by a joint of three rotations about the axes z, x, y (fixed to the
moving body, in that order) and three translations along the femur's axes; flexion counts negatively about z. OpenSim's
axes are x anterior, y proximal, z lateral (of a right knee); those of results are proximal, lateral, anterior.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, OutputError, PftwinWarning
from pftwin.files.result_files import finite_frames, motion_dataset, reservations, save_csv, save_sto, write_storage

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result


# Rows: OpenSim's x, y, z in a result's axes.
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SEQUENCE = "ZXY"
SIGNS = np.array([-1.0, 1.0, 1.0])
JOINTS = {"tibia": ("knee", ("flex", "add", "rot")), "patella": ("pf", ("flex", "rot", "tilt"))}


def save_mot(data: Dataset, path: str | os.PathLike[str]) -> None:
    """Writes the motion of tibia and patella in the femur, for OpenSim's models and its tools.

    Frames that are not finite are left out, with a warning.

    Raises:
        InputError: no frame that is finite.
        OutputError: the folder is missing, the path is a folder, or the place cannot be written to.
    """
    finite = finite_frames(data)
    lost = data.sizes["time"] - finite.size
    if not finite.size:
        raise InputError("no frame with a finite pose", where=data.attrs.get("scene"), remedy="a smaller time step")
    if lost:
        message = f"{lost} of {data.sizes['time']} frames are not finite and are left out"
        warnings.warn(message, PftwinWarning, stacklevel=2)
    shown = data.isel(time=finite)
    notes = ["Units are S.I. units (second, meters, Newtons, ...)", "Angles are in degrees."]
    rows = shown["time"].values, coordinates(shown)
    write_storage(path, "Coordinates", *rows, ("", *notes, *reservations(data), ""))


def coordinates(data: Dataset) -> dict[str, Floats]:
    """The twelve coordinates (n,) of a result's dataset by name [deg] and [m]: of the tibia, then of the patella.

    Left knees were mirrored to right ones on input, and stay so.
    """
    from scipy.spatial.transform import Rotation

    columns: dict[str, Floats] = {}
    for body, (joint, rotations) in JOINTS.items():
        quaternions = Rotation.from_quat(data[f"{body}_quaternion"].values, scalar_first=True)
        turn = Rotation.from_matrix(AXES @ quaternions.as_matrix() @ AXES.T)
        angles = np.degrees(np.unwrap(SIGNS * turn.as_euler(SEQUENCE), axis=0))
        columns |= {f"{joint}_{r}_r": angle for r, angle in zip(rotations, angles.T, strict=True)}
        places = data[f"{body}_position"].values @ AXES.T
        columns |= {f"{joint}_t{k}_r": place for k, place in zip("xyz", places.T, strict=True)}
    return columns


FORMATS = (".mot", ".sto", ".glb", ".csv")


def export(result: Result | str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Writes a result in the format that the suffix names: .mot, .sto, .glb or .csv.

    Args:
        result: a result, or the file of one.
        path: where to.

    Raises:
        InputError: no such file, or not a result.
        OutputError: an unknown suffix, or a place that cannot be written to.
    """
    target = check_format(path)
    if target.suffix.lower() == ".glb":
        from pftwin.files.interchange.glb import save_glb

        save_glb(result, target)
    else:
        save = {".mot": save_mot, ".sto": save_sto, ".csv": save_csv}[target.suffix.lower()]
        save(motion_dataset(result), target)


def check_format(path: str | os.PathLike[str]) -> Path:
    """The path; a suffix that is not known is an OutputError."""
    target = Path(path)
    if target.suffix.lower() not in FORMATS:
        raise OutputError(f"{target}: unknown format {target.suffix!r}; expected: {', '.join(FORMATS)}")
    return target
