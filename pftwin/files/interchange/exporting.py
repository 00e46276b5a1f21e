"""Exports a result to another program's format, chosen by the suffix; writes OpenSim's motion files (.mot).

Joint coordinates have the names and order of the OpenSim JAM models (Lenhart et al. 2015, Ann Biomed Eng 43:2675):
tibia and patella each move relative to the femur by a joint with three rotations about the axes z, x, y (fixed to the
moving body, in this order) and three translations along the femur's axes; flexion is negative about z. OpenSim's axes
are x anterior, y proximal, z lateral (of a right knee); those of results are x proximal, y lateral, z anterior.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, OutputError, PftwinWarning
from pftwin.files.result_files import (
    AXES,
    PFTWIN,
    check_axes,
    finite_frames,
    motion_dataset,
    reservations,
    save_csv,
    save_sto,
    write_storage,
)

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result


SEQUENCE = "ZXY"
SIGNS = np.array([-1.0, 1.0, 1.0])
JOINTS = {"tibia": ("knee", ("flex", "add", "rot")), "patella": ("pf", ("flex", "rot", "tilt"))}


def save_mot(data: Dataset, path: str | os.PathLike[str]) -> None:
    """Writes the motion of tibia and patella relative to the femur, for OpenSim's models and tools.

    Frames that are not finite are omitted, with a warning. Raises InputError for no finite frame, and OutputError for a
    path that is not writable.
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
    """Twelve joint coordinates (n,) by name, of the tibia, then the patella: rotations [deg] and translations [m].

    Left knees were mirrored to right ones on input, and are not mirrored back.
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
TABLES = (".sto", ".csv")  # formats that can be in the axes of pftwin or of the ISB; the others have their own


def export(result: Result | str | os.PathLike[str], path: str | os.PathLike[str], axes: str = PFTWIN) -> None:
    """Writes a result in the format of the suffix: .mot, .sto, .glb or .csv.

    Args:
        result: a result, or the path of a result's file.
        path: target file.
        axes: of a table (.sto, .csv): "pftwin", or "isb" for positions, forces and rotations in the axes of the
            International Society of Biomechanics, of a left knee as it is and not as its mirror image.

    Raises:
        InputError: no such file, or not a result; unknown axes, or axes of a format that has its own; ISB axes, and a
            file that does not tell the side of the knee.
        OutputError: an unknown suffix, or the file cannot be written.
    """
    target = check_format(path, axes)
    if target.suffix.lower() == ".glb":
        from pftwin.files.interchange.glb import save_glb

        save_glb(result, target)
    else:
        data = motion_dataset(result)
        if target.suffix.lower() == ".mot":
            save_mot(data, target)
        else:
            save = {".sto": save_sto, ".csv": save_csv}[target.suffix.lower()]
            save(data, target, axes)


def check_format(path: str | os.PathLike[str], axes: str = PFTWIN) -> Path:
    """Returns the path; raises OutputError for an unknown suffix, InputError for axes that it does not take."""
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in FORMATS:
        raise OutputError(f"{target}: unknown format {target.suffix!r}; expected: {', '.join(FORMATS)}")
    if check_axes(axes) != PFTWIN and suffix not in TABLES:
        raise InputError(
            f"found {axes!r} for {target}",
            where="axes",
            expected=f"{' or '.join(TABLES)}, which are tables",
            remedy=".mot files have OpenSim's axes in any case, which are the ISB's of a right knee",
        )
    return target
