"""Prescribed activities of a natural knee: flexion, tibial rotation, pose of the femur, and quadriceps force over time.

In a squat, femur and tibia are equally inclined. The distance of the knee from the line between hip and ankle is
proportional to the sine of half the flexion, and so is the moment that the quadriceps balances. In an extension against
a weight at the ankle the thigh is horizontal, and the weight's lever arm is proportional to the cosine of the flexion.
The tibia flexes about the condylar axis and rotates internally over the first 30 deg of flexion (screw-home motion:
17 deg in gait, Kim et al. 2015, Clin Orthop Surg 7:303; the value of 8 deg is a choice).
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
from pftwin.geometry.bones.implicit import smooth_step
from pftwin.geometry.bones.tibiofemoral import FLEXION_AXIS
from pftwin.model.motion import KneeMotion

STRAIGHT, BENT = 15.0, 90.0  # range of flexion [deg]
SCREW_HOME, SCREWED = 8.0, 30.0  # internal rotation of the tibia, and the flexion at which it is complete [deg]
AT_REST = 0.05  # share of the largest force that remains in an extension when the shank hangs down: a choice
RATE = 60.0  # frames per second
GRAVITY = (-9.81, 0.0, 0.0)  # in the world, whose x points up [m/s^2]


class Activity(NamedTuple):
    """Prescribed motion and quadriceps force at n frames."""

    name: str
    motion: KneeMotion
    flexion: Floats  # (n,) of the knee [deg]
    inclined: Floats  # (n,) backward inclination of the femur from its orientation in full extension [deg]
    pull: Floats  # (n,) total quadriceps force as a share of its maximum


def squat(duration: float) -> Activity:
    """Returns a squat, down and up, with a duration [s] rounded so that one frame is at the deepest flexion.

    Raises:
        InputError: the duration is out of range.
    """
    times, there = _there_and_back(duration)
    flexion = STRAIGHT + (BENT - STRAIGHT) * there
    inclined = 0.5 * flexion
    pull = np.sin(np.radians(inclined)) / np.sin(np.radians(0.5 * BENT))
    return Activity("squat", _motion("squat", times, inclined, flexion), flexion, inclined, pull)


def extension(duration: float) -> Activity:
    """Returns a seated knee extension against a weight at the ankle, out and back, with a duration [s] as in `squat`.

    Raises:
        InputError: the duration is out of range.
    """
    times, there = _there_and_back(duration)
    flexion = BENT - (BENT - STRAIGHT) * there
    inclined = np.full_like(flexion, 90.0)
    lever = np.cos(np.radians(flexion)) / np.cos(np.radians(STRAIGHT))
    pull = AT_REST + (1 - AT_REST) * lever
    return Activity("extension", _motion("extension", times, inclined, flexion), flexion, inclined, pull)


ACTIVITIES = {"squat": squat, "extension": extension}


def _there_and_back(duration: float) -> tuple[Floats, Floats]:
    """Times of the frames [s], and the progress of the motion: 0 at both ends, 1 in the middle."""
    if not 0.2 <= duration <= 60:
        raise InputError(f"found {duration!r}", where="duration", expected="0.2 to 60 s")
    times = np.arange(2 * round(0.5 * duration * RATE) + 1) / RATE
    return times, 0.5 - 0.5 * np.cos(2 * np.pi * times / times[-1])


def tibia_turn(flexion: Floats) -> Rotation:
    """Returns the tibia's rotation in the femur frame for flexions [deg], with internal rotation from screw-home."""
    inward = SCREW_HOME * smooth_step(flexion / SCREWED)
    q = tibiofemoral_orientation(*(np.radians(a) for a in (flexion, 0 * flexion, inward)))
    return Rotation.from_quat(np.stack([q.w, q.x, q.y, q.z], axis=-1), scalar_first=True)


def _motion(name: str, times: NDArray, inclined: NDArray, flexion: NDArray) -> KneeMotion:
    femur = Rotation.from_euler("Y", inclined[:, None], degrees=True)
    tibia = femur * tibia_turn(flexion)
    axis = 1e-3 * np.array([FLEXION_AXIS[0], 0.0, FLEXION_AXIS[1]])
    places = {"femur": np.zeros((times.size, 3)), "tibia": femur.apply(axis) - tibia.apply(axis)}
    femoral, tibial = (
        PoseSeries(times, places[bone], turn.as_quat(scalar_first=True), source=f"{name}, {bone}")
        for bone, turn in (("femur", femur), ("tibia", tibia))
    )
    return KneeMotion.from_poses(femoral, tibial)
