"""Recorded poses of femur and tibia as numpy arrays, for results."""

from __future__ import annotations

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.leaves import host_array
from pftwin.base.spatial import Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.motion import KneeMotion, SegmentMotion


def tibia_orientation(motion: KneeMotion) -> Quaternion:
    """Orientation of the tibia in the femur at the recorded frames, with components (n,)."""
    q = _orientation(motion.tibia, motion.times)
    return q if motion.femur is None else _orientation(motion.femur, motion.times).conjugate() * q


def tibia_position(motion: KneeMotion) -> Floats:
    """Origin of the tibia frame in the femur frame at the recorded frames, (n, 3) [m]."""
    origin = _spline(motion.tibia, motion.tibia.position_coefficients, motion.times)
    return seen_from_femur(motion, origin[:, None])[:, 0]


def seen_from_femur(motion: KneeMotion, points: Floats) -> Floats:
    """World points (k, 3), or (n, k, 3) at the recorded frames, expressed in the femur frame [m].

    The result has shape (n, k, 3) if the femur moves; if it is the world, the points are returned unchanged.
    """
    if motion.femur is None:
        return points
    axes = host_array(_orientation(motion.femur, motion.times).rotation())
    origin = _spline(motion.femur, motion.femur.position_coefficients, motion.times)
    return np.einsum("nij,nki->nkj", axes, points - origin[:, None])


def first_pose(motion: KneeMotion, body: str) -> tuple[Floats, Floats] | None:
    """Origin (3,) [m] and axes as columns (3, 3) of "femur" or "tibia" at the first frame; None for the world."""
    segment = motion.femur if body == "femur" else motion.tibia
    if segment is None:
        return None
    times = motion.times[:1]
    axes = host_array(_orientation(segment, times).rotation())[0]
    return _spline(segment, segment.position_coefficients, times)[0], axes


def poses(segment: SegmentMotion | None, times: Floats) -> PoseSeries:
    """Poses of a segment at times (n,) [s]; None is fixed in the world."""
    if segment is None:
        return PoseSeries(times, np.zeros((len(times), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1)))
    position = _spline(segment, segment.position_coefficients, times)
    return PoseSeries(times, position, host_array(_orientation(segment, times)))


def _orientation(motion: SegmentMotion, times: Floats) -> Quaternion:
    """Unit quaternions of the spline at times (n,) [s], as in `SegmentMotion.frames`, in double precision."""
    q = _spline(motion, motion.quaternion_coefficients, times)
    return Quaternion(*(q / np.sqrt(np.einsum("ij,ij->i", q, q))[:, None]).T)


def _spline(motion: SegmentMotion, coefficients: object, times: Floats) -> Floats:
    """A segment's cubic spline at times (n,) [s], (n, 3) or (n, 4)."""
    knots, c = (np.asarray(a, dtype=np.float64) for a in (motion.knots, coefficients))
    interval = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, knots.size - 2)
    s, c = (times - knots[interval])[:, None], c[:, interval]
    return ((c[0] * s + c[1]) * s + c[2]) * s + c[3]
