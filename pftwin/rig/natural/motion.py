"""What a natural knee does: flexion over time, the tibia's rotation with it, the femur's place, and the muscles' pull.

A squat, down and up again, femur and tibia inclined alike. The knee is before the line from hip to ankle by as much as
the sine of half its flexion, and so the moment that the quadriceps holds rises with it. The tibia turns about the
condyles' axis, and inward over the first 30 deg of flexion (screw-home: 17 deg in gait, Kim et al. 2015,
Clin Orthop Surg 7:303; 8 is a choice).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.rotations import tibiofemoral_orientation
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.motion import KneeMotion
from pftwin.rig.natural.femur import FLEXION_AXIS
from pftwin.rig.natural.implicit import smooth_step

STRAIGHT, BENT = 15.0, 90.0  # flexion between which it goes [deg]
SCREW_HOME, SCREWED = 8.0, 30.0  # inward turn of the tibia, and the flexion at which it is complete [deg]
RATE = 60.0  # frames in a second


class Activity(NamedTuple):
    """What is prescribed, at each frame."""

    motion: KneeMotion
    flexion: Floats  # (n,) of the knee [deg]
    inclined: Floats  # (n,) the femur backward from its place in full extension [deg]
    pull: Floats  # (n,) of all the quadriceps, as a share of its largest
    gravity: tuple[float, float, float]  # in the world [m/s^2]


def squat(duration: float) -> Activity:
    """A squat that takes so long [s], to the next even number of frames: one of them is at the deepest.

    Raises:
        InputError: a duration that is no time for it.
    """
    if not 0.2 <= duration <= 60:
        raise InputError(f"found {duration!r}", where="duration", expected="0.2 to 60 s")
    times = np.arange(2 * round(0.5 * duration * RATE) + 1) / RATE
    flexion = STRAIGHT + (BENT - STRAIGHT) * (0.5 - 0.5 * np.cos(2 * np.pi * times / times[-1]))
    inclined = 0.5 * flexion
    pull = np.sin(np.radians(inclined)) / np.sin(np.radians(0.5 * BENT))
    return Activity(_motion(times, inclined, flexion), flexion, inclined, pull, (-9.81, 0.0, 0.0))


def tibia_turn(flexion: Floats) -> Rotation:
    """Of the tibia in the femur [deg]: it turns inward as it bends, from none in full extension."""
    inward = SCREW_HOME * smooth_step(flexion / SCREWED)
    q = tibiofemoral_orientation(*(np.radians(a) for a in (flexion, 0 * flexion, inward)))
    return Rotation.from_quat(np.stack([q.w, q.x, q.y, q.z], axis=-1), scalar_first=True)


def _motion(times: NDArray, inclined: NDArray, flexion: NDArray) -> KneeMotion:
    femur = Rotation.from_euler("Y", inclined[:, None], degrees=True)
    tibia = femur * tibia_turn(flexion)
    axis = 1e-3 * np.array([FLEXION_AXIS[0], 0.0, FLEXION_AXIS[1]])
    places = {"femur": np.zeros((times.size, 3)), "tibia": femur.apply(axis) - tibia.apply(axis)}
    femoral, tibial = (
        PoseSeries(times, places[bone], turn.as_quat(scalar_first=True), source=f"squat, {bone}")
        for bone, turn in (("femur", femur), ("tibia", tibia))
    )
    return KneeMotion.from_poses(femoral, tibial)
