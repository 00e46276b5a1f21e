"""Joint coordinates of a result, as OpenSim's knee models name and define them.

Names and sequence are those of the models of OpenSim JAM (Lenhart et al. 2015, Ann Biomed Eng 43:2675): tibia and
patella each move in the femur by a joint of three rotations about the axes z, x, y (fixed to the moving body, in that
order) and three translations along the femur's axes; flexion counts negatively about z. OpenSim's axes are x anterior,
y proximal, z lateral (of a right knee); those of results are proximal, lateral, anterior.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from xarray import Dataset

# Rows: OpenSim's x, y, z in a result's axes.
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SEQUENCE = "ZXY"
SIGNS = np.array([-1.0, 1.0, 1.0])
JOINTS = {"tibia": ("knee", ("flex", "add", "rot")), "patella": ("pf", ("flex", "rot", "tilt"))}
Floats = NDArray[np.float64]


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
