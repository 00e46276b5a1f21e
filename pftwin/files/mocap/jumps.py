"""Frames in which a patella is somewhere else than the frames around say: mistaken, not moved.

What is measured frame by frame (by registration of images, or from markers that were swapped) is wrong for single
frames or stretches of them, and right in between. Kept is the longest series of frames of which each can be reached
from the one before, by a patella in its groove: as fast as any, or several times as fast as this one usually is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.files.mocap.poses import PoseSeries

_APART, _TURNED = 5e-3, np.radians(15.0)  # [m], [rad] that two frames of a good recording may differ by, however close
_SPEED, _SPIN = 0.25, 6.0  # [m/s], [rad/s] at which a patella may move in the femur, and
_FASTER = 8.0  # times its usual speed, the lower quartile: where two frames in five are wrong, four steps in five are
_COASTS = 3  # frames for which it is taken to go on moving at that speed where others are skipped
_BACK = 200  # frames before each that are tried, and the end of the longest series before these
_NAMED = 8  # stretches that are named


def jumps(poses: PoseSeries) -> NDArray[np.bool_]:
    """Which frames (n,) of a patella in its femur are out of line."""
    n, times = poses.times.size, poses.times
    step = np.arange(1, n)
    away, turn = _between(poses, step - 1, step)
    interval = np.diff(times)
    if n < 2:
        return np.zeros(n, bool)
    usual = (float(np.quantile(a / interval, 0.25)) for a in (away, turn))
    speed, spin = (max(least, _FASTER * u) for least, u in zip((_SPEED, _SPIN), usual, strict=True))
    coasting = _COASTS * float(np.median(interval))
    length, before, longest = np.ones(n, int), np.full(n, -1), 0
    for k in range(1, n):
        if k > _BACK and length[k - _BACK - 1] >= length[longest]:
            longest = k - _BACK - 1
        near = np.arange(max(k - _BACK, 0), k)
        earlier = near if near[0] == 0 else np.append(near, longest)
        away, turn = _between(poses, earlier, k)
        passed = times[k] - times[earlier]
        passed = np.where(earlier == k - 1, passed, np.minimum(passed, coasting))
        reached = (away <= _APART + speed * passed) & (turn <= _TURNED + spin * passed)
        if reached.any():
            best = earlier[reached][np.argmax(length[earlier[reached]])]
            length[k], before[k] = length[best] + 1, best
    odd, at = np.ones(n, bool), int(np.argmax(length))
    while at >= 0:
        odd[at] = False
        at = before[at]
    return odd


def in_words(odd: NDArray[np.bool_]) -> str:
    """The frames, counted from 1: "frames 3 to 5, 9"."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], odd, [False]]).astype(int)))
    runs = [f"{a + 1}" if b == a + 1 else f"{a + 1} to {b}" for a, b in edges.reshape(-1, 2)]
    more = f" and {len(runs) - _NAMED} more stretches" if len(runs) > _NAMED else ""
    return f"frame{'s' if odd.sum() > 1 else ''} {', '.join(runs[:_NAMED])}{more}"


def _between(
    poses: PoseSeries, one: NDArray[np.intp], other: NDArray[np.intp] | int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances [m] and angles [rad] between frames."""
    away = np.linalg.norm(poses.positions[one] - poses.positions[other], axis=-1)
    cosine = np.abs(np.sum(poses.quaternions[one] * poses.quaternions[other], axis=-1))
    return away, 2 * np.arccos(np.minimum(cosine, 1.0))
