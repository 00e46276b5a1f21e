"""Checks on the times of a recording."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError

# Printed times are rounded (three decimals at 120 Hz: 6 % of an interval); a lost frame is 100 % off.
_ROUNDING_SHARE = 0.1


def increasing_times(times: ArrayLike, *, where: object) -> NDArray[np.float64]:
    """Times [s] as a float64 array of shape (n,), finite and strictly increasing.

    Raises:
        InputError: empty, not one-dimensional, not finite, repeated or unsorted; the message names the row (from 1).
    """
    t = np.asarray(times, dtype=np.float64)
    if t.ndim != 1 or not t.size:
        raise InputError(f"times of shape {t.shape}", where=where, expected="one time per frame, at least one")
    if (bad := np.flatnonzero(~np.isfinite(t))).size:
        raise InputError(f"row {bad[0] + 1} has no finite time", where=where, expected="a time in seconds on every row")
    if (bad := np.flatnonzero(np.diff(t) <= 0)).size:
        i = int(bad[0]) + 1
        kind = "repeats the time" if t[i] == t[i - 1] else "goes back in time:"
        detail = f"{t[i]:.9g} s" if t[i] == t[i - 1] else f"{t[i]:.9g} s after {t[i - 1]:.9g} s"
        raise InputError(
            f"row {i + 1} {kind} {detail}",
            where=where,
            expected="strictly increasing times",
            remedy="sort the rows and remove repeated ones",
        )
    return t


def uniform_times(times: ArrayLike, *, where: object) -> NDArray[np.float64]:
    """The even grid that the recorded times stand for: t0 + i (t_last - t0) / (n - 1).

    A recording's times are an even grid, rounded when printed; the rounding would show up as noise in velocities.

    Raises:
        InputError: a time lies more than a tenth of an interval from the grid; the message names the row.
    """
    t = increasing_times(times, where=where)
    if t.size < 3:
        return t
    grid = np.linspace(t[0], t[-1], t.size)
    interval = grid[1] - grid[0]
    if np.max(np.abs(t - grid)) > _ROUNDING_SHARE * interval:
        steps = np.diff(t)
        i = int(np.argmax(np.abs(steps - np.median(steps))))
        raise InputError(
            f"times are not evenly spaced: {steps[i]:.6g} s between rows {i + 1} and {i + 2}, "
            f"{np.median(steps):.6g} s elsewhere",
            where=where,
            expected="one sampling rate throughout",
            remedy="resample the recording, or mark lost frames as rows with empty cells",
        )
    return grid


def sampling_rate(times: NDArray[np.float64], *, where: object) -> float:
    """Frames per second [Hz] of evenly spaced times.

    Raises:
        InputError: fewer than two frames, or uneven spacing.
    """
    if times.size < 2:
        raise InputError("one frame has no sampling rate", where=where, expected="at least two frames")
    grid = uniform_times(times, where=where)
    return float((grid.size - 1) / (grid[-1] - grid[0]))


def frames_between(times: NDArray[np.float64], start: float, end: float, *, where: object) -> NDArray[np.bool_]:
    """Mask (n,) of the times within [start, end], to within a rounding error.

    Raises:
        InputError: no frame lies in between.
    """
    slack = 1e-9 * max(1.0, abs(start), abs(end))
    keep = (times >= start - slack) & (times <= end + slack)
    if not keep.any():
        raise InputError(
            f"no frame between {start:g} s and {end:g} s",
            where=where,
            expected=f"an interval within {times[0]:g} s to {times[-1]:g} s",
        )
    return keep
