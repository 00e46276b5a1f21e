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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, OutputError, PftwinWarning
from pftwin.files.result_files import finite_frames, motion_dataset, save_csv, save_sto, write_storage

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result


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
    finite = finite_frames(data)
    lost = data.sizes["time"] - finite.size
    if not finite.size:
        raise InputError("no frame with a finite pose", where=data.attrs.get("scene"), remedy="a smaller time step")
    if lost:
        message = f"{lost} of {data.sizes['time']} frames are not finite and are left out"
        warnings.warn(message, PftwinWarning, stacklevel=2)
    times, names, values, rotational = coordinates(data.isel(time=finite))
    shown = np.where(rotational, np.degrees(values), values)
    note = [f"Note: {data.attrs['note']}"] if "note" in data.attrs else []
    write_storage(path, "Coordinates", times, dict(zip(names, shown.T, strict=True)), ("", *_UNITS, *note, ""))


# Rows: OpenSim's x, y, z in a result's axes.
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SEQUENCE = "ZXY"
SIGNS = np.array([-1.0, 1.0, 1.0])
JOINTS = {"tibia": ("knee", ("flex", "add", "rot")), "patella": ("pf", ("flex", "rot", "tilt"))}


class Coordinates(NamedTuple):
    """Values over time."""

    times: Floats  # (n,) [s]
    names: tuple[str, ...]
    values: Floats  # (n, coordinates) [rad] and [m]
    rotational: tuple[bool, ...]


def coordinates(data: Dataset) -> Coordinates:
    """The twelve coordinates of a result: of the tibia, then of the patella.

    Args:
        data: as `Result.to_dataset` makes it, or `result_files.load_dataset` reads it. Left knees were mirrored to
            right ones on input, and stay so.
    """
    names: list[str] = []
    columns: list[Floats] = []
    for body, (joint, rotations) in JOINTS.items():
        angles, places = of_poses(data[f"{body}_position"].values, data[f"{body}_quaternion"].values)
        names += [f"{joint}_{r}_r" for r in rotations] + [f"{joint}_t{k}_r" for k in "xyz"]
        columns += [angles, places]
    turning = (True, True, True, False, False, False) * len(JOINTS)
    return Coordinates(data["time"].values, tuple(names), np.concatenate(columns, axis=1), turning)


def of_poses(position: Floats, quaternion: Floats) -> tuple[Floats, Floats]:
    """Angles (n, 3) [rad] and translations (n, 3) [m] of a body in the femur.

    Args:
        position: (n, 3) in a result's axes [m].
        quaternion: (n, 4) scalar first, in a result's axes.
    """
    from scipy.spatial.transform import Rotation

    turn = AXES @ Rotation.from_quat(quaternion, scalar_first=True).as_matrix() @ AXES.T
    angles = SIGNS * Rotation.from_matrix(turn).as_euler(SEQUENCE)
    return np.unwrap(angles, axis=0), position @ AXES.T


FORMATS = {
    ".mot": "joint coordinates for OpenSim, angles in degrees",
    ".sto": "everything, as an OpenSim storage",
    ".glb": "the moving knee in three dimensions, glTF 2.0",
    ".csv": "everything, as a table",
}


def export(result: Result | str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Writes a result in the format that the suffix names: one of `FORMATS`.

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
        return
    {".mot": save_mot, ".sto": save_sto, ".csv": save_csv}[target.suffix.lower()](motion_dataset(result), target)


def check_format(path: str | os.PathLike[str]) -> Path:
    """The path, if its suffix is known.

    Raises:
        OutputError: otherwise.
    """
    target = Path(path)
    if target.suffix.lower() not in FORMATS:
        raise OutputError(f"{target}: unknown format {target.suffix!r}; expected: {', '.join(FORMATS)}")
    return target
