"""Detects frames in which a recorded bone jumps faster than it can move; fills those of femur and tibia.

Poses measured frame by frame (by image registration, or from markers that were swapped) are wrong in single frames or
in runs of frames. All frames are outliers except the longest sequence in which each frame can be reached from the one
before at a plausible speed: that of any patella in its groove, or several times the usual speed of this one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.mocap.tables import runs

_NEAR = 1e-3  # [m] scale of the soft-L1 loss on the knee's distance from its mean position


def mended_bones(
    femur: PoseSeries | None, tibia: PoseSeries, *, max_gap_s: float, speed: float, spin: float
) -> tuple[PoseSeries | None, PoseSeries, list[str]]:
    """Fills runs of frames in which femur or tibia jumps out and back.

    Outliers are those that `jumps` finds for the tibia in the femur, at the point that moves least in both: near the
    knee, wherever the bones' frames are. The bone that is farther from the cubic spline through the frames around is
    replaced by that spline (positions and quaternions); the other one too in frames that remain outliers.

    Args:
        femur: poses; None for a fixed femur.
        tibia: poses at the same times.
        max_gap_s: longest run that is filled [s].
        speed: largest speed of the tibia relative to the femur [m/s].
        spin: largest angular speed of the tibia relative to the femur [rad/s].

    Returns:
        Poses of femur and tibia, and descriptions of what was filled.

    Raises:
        InputError: a longer run, or one at the start or end, naming its frames.
    """
    bones = [tibia] if femur is None else [femur, tibia]
    knee = _knee(_in_femur(bones))

    def out_of_line(bones: list[PoseSeries]) -> NDArray[np.bool_]:
        return _jumps_at(knee, _in_femur(bones), speed, spin)

    odd = out_of_line(bones)
    if not odd.any():
        return femur, tibia, []
    stretches = runs(odd)
    _check_gaps(stretches, tibia, max_gap_s)
    curves = [_spline(bone, odd) for bone in bones]
    off = np.array([_off(bone, curve) for bone, curve in zip(bones, curves, strict=True)])
    wrong = np.zeros((len(bones), odd.size), bool)

    def filled() -> list[PoseSeries]:
        return [_where(w, c, b) for w, c, b in zip(wrong, curves, bones, strict=True)]

    for first, end in stretches:
        wrong[np.argmax(off[:, first:end].max(axis=1)), first:end] = True
    still = out_of_line(filled())
    for first, end in stretches:
        wrong[:, first:end] |= still[first:end].any()
    mended = filled()
    words = [
        f"{bone.source}: {in_words(w)} of {odd.size} (counted from 1) filled by a spline: it jumps there out and back"
        for bone, w in zip(bones, wrong, strict=True)
        if w.any()
    ]
    return (None if femur is None else mended[0]), mended[-1], words


def knee_jumps(tibia: PoseSeries, *, speed: float, spin: float) -> NDArray[np.bool_]:
    """Which frames (n,) of a tibia in the femur are outliers for `mended_bones`."""
    return _jumps_at(_knee(tibia), tibia, speed, spin)


def _jumps_at(knee: Floats, tibia: PoseSeries, speed: float, spin: float) -> NDArray[np.bool_]:
    """Outliers of the tibia in the femur, by its point (3,) at the knee."""
    return jumps(replace(tibia, positions=tibia.positions + tibia.matrices() @ knee), speed=speed, spin=spin)


def _in_femur(bones: list[PoseSeries]) -> PoseSeries:
    return bones[0] if len(bones) == 1 else bones[1].relative_to(bones[0])


def _where(frames: NDArray[np.bool_], there: PoseSeries, elsewhere: PoseSeries) -> PoseSeries:
    if not frames.any():
        return elsewhere
    choose = frames[:, None]
    positions = np.where(choose, there.positions, elsewhere.positions)
    return replace(
        elsewhere, positions=positions, quaternions=np.where(choose, there.quaternions, elsewhere.quaternions)
    )


def _knee(poses: PoseSeries) -> Floats:
    """Point (3,) of the tibia [m] that moves least in the femur, by a robust fit."""
    from scipy.optimize import least_squares

    turns = poses.matrices()

    def off(both: Floats) -> Floats:
        return (poses.positions + turns @ both[:3] - both[3:]).ravel()

    slopes = np.concatenate([turns, np.broadcast_to(-np.eye(3), turns.shape)], axis=2).reshape(-1, 6)
    start = np.concatenate([np.zeros(3), np.median(poses.positions, axis=0)])
    return least_squares(off, start, jac=lambda _: slopes, loss="soft_l1", f_scale=_NEAR).x[:3]  # pyright: ignore[reportArgumentType]


def _spline(poses: PoseSeries, odd: NDArray[np.bool_]) -> PoseSeries:
    """Poses on the spline through the frames that are not marked odd."""
    from scipy.interpolate import CubicSpline

    good = PoseSeries(poses.times[~odd], poses.positions[~odd], poses.quaternions[~odd])  # continuous signs
    curve = CubicSpline(good.times, np.concatenate([good.positions, good.quaternions], axis=1))(poses.times)
    quaternions = curve[:, 3:] / np.linalg.norm(curve[:, 3:], axis=1, keepdims=True)
    return replace(poses, positions=curve[:, :3], quaternions=quaternions)


def _off(poses: PoseSeries, curve: PoseSeries) -> Floats:
    """Deviation (n,) of each frame from the spline, relative to the difference allowed between any two frames."""
    away = np.linalg.norm(poses.positions - curve.positions, axis=1)
    return np.maximum(away / APART, turned(poses.quaternions, curve.quaternions) / TURNED)


def _check_gaps(stretches: NDArray[np.intp], tibia: PoseSeries, max_gap_s: float) -> None:
    times = tibia.times
    interval = float(np.median(np.diff(times)))
    refused = np.zeros(times.size, bool)
    for first, end in stretches:
        if first == 0 or end == times.size or times[end] - times[first - 1] - interval > max_gap_s + 1e-6 * interval:
            refused[first:end] = True
    if refused.any():
        raise InputError(
            f"femur and tibia jump against each other in {in_words(refused)} of {times.size} (counted from 1)",
            where=tibia.source,
            expected=f"stretches of at most {max_gap_s:g} s (max_gap_s) to fill, not at the end",
            remedy="start_time_s and end_time_s, or a larger max_gap_s, in [motion]; or, if it is meant, a larger "
            "most_knee_speed_m_per_s, or most_angular_speed_rad_per_s, in [limits]",
        )


APART, TURNED = 5e-3, np.radians(15.0)  # [m], [rad] difference allowed between any two frames, at zero time
_SPEED, _SPIN = 0.25, 6.0  # [m/s], [rad/s] speed allowed for a patella in the femur, or, if larger,
_FASTER = 8.0  # this multiple of its usual speed (lower quartile: if 2 of 5 frames are wrong, so are 4 of 5 steps)
_COASTS = 3  # largest number of frames' time for which motion at that speed is allowed when frames are skipped
_BACK = 200  # number of preceding frames tried as predecessors, besides the end of the longest earlier sequence
_NAMED = 8  # largest number of runs listed in a message
Frames = NDArray[np.intp]
Reached = Callable[[Frames, Frames | int, Floats], NDArray[np.bool_]]


def jumps(poses: PoseSeries, *, speed: float = _SPEED, spin: float = _SPIN) -> NDArray[np.bool_]:
    """Which frames (n,) of a patella in the femur are outliers; for another body give its speeds [m/s], [rad/s]."""
    n, times = poses.times.size, poses.times
    if n < 2:
        return np.zeros(n, bool)
    usual = (float(np.quantile(s / np.diff(times), 0.25)) for s in _between(poses, np.arange(n - 1), np.arange(1, n)))
    fast, quick = (max(least, _FASTER * u) for least, u in zip((speed, spin), usual, strict=True))

    def reached(earlier: Frames, later: Frames | int, passed: Floats) -> NDArray[np.bool_]:
        away, turn = _between(poses, earlier, later)
        return (away <= APART + fast * passed) & (turn <= TURNED + quick * passed)

    return out_of_line(times, reached)


def out_of_line(times: Floats, reached: Reached, *, coasting: float | None = None) -> NDArray[np.bool_]:
    """Which frames (n,) are not in the longest sequence in which each frame can be reached from the one before.

    Args:
        times: (n,) seconds, increasing.
        reached: function of earlier frames, later frames and the seconds between them: whether these can be reached.
        coasting: largest time for the motion when frames are skipped [s]; by default that of three frames.
    """
    n = times.size
    if reached(np.arange(n - 1), np.arange(1, n), np.diff(times)).all():
        return np.zeros(n, bool)
    coasting = coasts(times) if coasting is None else coasting
    length, before, longest = np.ones(n, int), np.full(n, -1), 0
    for k in range(1, n):
        if k > _BACK and length[k - _BACK - 1] >= length[longest]:
            longest = k - _BACK - 1
        near = np.arange(max(k - _BACK, 0), k)
        earlier = near if near[0] == 0 else np.append(near, longest)
        passed = times[k] - times[earlier]
        passed = np.where(earlier == k - 1, passed, np.minimum(passed, coasting))
        follows = reached(earlier, k, passed)
        if follows.any():
            best = earlier[follows][np.argmax(length[earlier[follows]])]
            length[k], before[k] = length[best] + 1, best
    odd, at = np.ones(n, bool), int(np.argmax(length))
    while at >= 0:
        odd[at] = False
        at = before[at]
    return odd


def coasts(times: Floats) -> float:
    """Default time [s] for which motion is allowed when frames are skipped."""
    return _COASTS * float(np.median(np.diff(times))) if times.size > 1 else 0.0


def in_words(odd: NDArray[np.bool_]) -> str:
    """Describes frames (n,) bool, counted from 1: "frames 3 to 5, 9"."""
    stretches = [f"{a + 1}" if b == a + 1 else f"{a + 1} to {b}" for a, b in runs(odd)]
    more = f" and {len(stretches) - _NAMED} more stretches" if len(stretches) > _NAMED else ""
    return f"frame{'s' if odd.sum() > 1 else ''} {', '.join(stretches[:_NAMED])}{more}"


def _between(poses: PoseSeries, one: Frames, other: Frames | int) -> tuple[Floats, Floats]:
    """Distances [m] and angles [rad] between frames."""
    away = np.linalg.norm(poses.positions[one] - poses.positions[other], axis=-1)
    return away, turned(poses.quaternions[one], poses.quaternions[other])


def turned(one: Floats, other: Floats) -> Floats:
    """Angles [rad] between unit quaternions (..., 4)."""
    return 2 * np.arccos(np.minimum(np.abs(np.sum(one * other, axis=-1)), 1.0))
