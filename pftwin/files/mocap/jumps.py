"""Detects outlier frames, in which the pose of a patella jumps faster than it can move.

Poses measured frame by frame (by image registration, or from markers that were swapped) are wrong in single frames or
in runs of frames. All frames are outliers except the longest sequence in which each frame can be reached from the one
before at a plausible speed: that of any patella in its groove, or several times the usual speed of this one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.mocap.tables import runs

APART, TURNED = 5e-3, np.radians(15.0)  # [m], [rad] difference allowed between any two frames, at zero time
_SPEED, _SPIN = 0.25, 6.0  # [m/s], [rad/s] speed allowed for a patella in the femur, or, if larger,
_FASTER = 8.0  # this multiple of its usual speed (lower quartile: if 2 of 5 frames are wrong, so are 4 of 5 steps)
_COASTS = 3  # largest number of frames' time for which motion at that speed is allowed when frames are skipped
_BACK = 200  # number of preceding frames tried as predecessors, besides the end of the longest earlier sequence
_NAMED = 8  # largest number of runs listed in a message
Frames = NDArray[np.intp]
Reached = Callable[[Frames, Frames | int, NDArray[np.float64]], NDArray[np.bool_]]


def jumps(poses: PoseSeries, *, speed: float = _SPEED, spin: float = _SPIN) -> NDArray[np.bool_]:
    """Which frames (n,) of a patella in the femur are outliers; for another body give its speeds [m/s], [rad/s]."""
    n, times = poses.times.size, poses.times
    if n < 2:
        return np.zeros(n, bool)
    usual = (float(np.quantile(s / np.diff(times), 0.25)) for s in _between(poses, np.arange(n - 1), np.arange(1, n)))
    fast, quick = (max(least, _FASTER * u) for least, u in zip((speed, spin), usual, strict=True))

    def reached(earlier: Frames, later: Frames | int, passed: NDArray[np.float64]) -> NDArray[np.bool_]:
        away, turn = _between(poses, earlier, later)
        return (away <= APART + fast * passed) & (turn <= TURNED + quick * passed)

    return out_of_line(times, reached)


def out_of_line(times: NDArray[np.float64], reached: Reached, *, coasting: float | None = None) -> NDArray[np.bool_]:
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


def coasts(times: NDArray[np.float64]) -> float:
    """Default time [s] for which motion is allowed when frames are skipped."""
    return _COASTS * float(np.median(np.diff(times))) if times.size > 1 else 0.0


def in_words(odd: NDArray[np.bool_]) -> str:
    """Describes frames (n,) bool, counted from 1: "frames 3 to 5, 9"."""
    stretches = [f"{a + 1}" if b == a + 1 else f"{a + 1} to {b}" for a, b in runs(odd)]
    more = f" and {len(stretches) - _NAMED} more stretches" if len(stretches) > _NAMED else ""
    return f"frame{'s' if odd.sum() > 1 else ''} {', '.join(stretches[:_NAMED])}{more}"


def _between(poses: PoseSeries, one: Frames, other: Frames | int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances [m] and angles [rad] between frames."""
    away = np.linalg.norm(poses.positions[one] - poses.positions[other], axis=-1)
    return away, turned(poses.quaternions[one], poses.quaternions[other])


def turned(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles [rad] between unit quaternions (..., 4)."""
    return 2 * np.arccos(np.minimum(np.abs(np.sum(one * other, axis=-1)), 1.0))
