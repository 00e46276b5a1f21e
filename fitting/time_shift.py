"""Estimates by how much a measured channel is late or early, together with the parameters, which may absorb a part.

Each channel is compared with the fitted motion shifted in time, p(t - s), after projecting out the parameters' linear
effect. Model errors are slow, so residuals are correlated from frame to frame: they are whitened by differencing
neighbouring frames (generalised least squares, first-order autoregressive noise) before their sum of squares is
minimised over s. The standard deviation follows from the curvature at the minimum. Friction in the joint and other
effects that the twin omits also delay the measurements. So a shift is reported only if it exceeds the limit by two
standard deviations, is known to a quarter of the limit, and explains more of the whitened squares than those effects
do: the rig's positions reach 0.07, and 0.35 to 0.47 if 30 ms late; its tensions 0.32, and 0.10 to 0.45. Only damping
or friction that the twin overstates makes measurements early, so a smaller share is enough there: the rig's reach 0.06,
and its positions 0.12 to 0.25 if 50 ms early.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.channel_checks import Limits, limit_remedy
from fitting.objective import Objective
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError

EXPLAINED = (1 / 6, 1 / 3)  # least share of the whitened squares of a pose, and of a force, that a delay must explain
EARLY = 0.1  # the same for a lead of either
_LARGEST = 0.2  # largest shift searched [s], and at most this share of the recording:
_SHARE = 1 / 8
_SHORT = 0.1  # if no larger shifts than this are searched [s], a minimum at the end may be slow model error
_STEPS = 40  # most steps of the search to either side
_ROUNDS = 3  # alternations of shift, and correlation of the residuals


class TimeShift(NamedTuple):
    """A channel's shift against the motion of femur and tibia."""

    seconds: float  # positive: the channel is late
    deviation: float  # its standard deviation [s]
    explained: float  # share of the channel's whitened squares that it explains
    enough: float  # least such share for a shift to be reported
    change: Floats  # (p,) change of the parameters if the shift were removed
    at_least: bool = False  # whether it is the largest shift searched: then it may be larger, without a deviation

    def exceeds(self, limit: float) -> bool:
        """Whether the shift surely exceeds a limit [s], is known well, and explains enough of the residuals."""
        sure = abs(self.seconds) - 2 * self.deviation > limit and self.deviation < 0.25 * limit
        return sure and self.explained >= self.enough


def time_shifts(objective: Objective, times: Floats, values: Floats, slopes: Floats) -> dict[str, TimeShift]:
    """Time shift of each channel, from a fit's motion (n, c) and its derivatives (n, c, p).

    Empty if the recording is too short for a shift of two frames.
    """
    largest = min(_LARGEST, _SHARE * float(times[-1] - times[0]))
    if largest < 2 * float(np.median(np.diff(times))):
        return {}
    inner = (times >= times[0] + largest) & (times <= times[-1] - largest)
    present = objective.present & inner[:, None]
    fit = _Fitted(objective, times, values, objective.slopes(slopes[None], values[None])[0], present)
    return {
        channel: found
        for channel, columns, rows in objective.columns()
        if (found := _shift(fit, columns, rows, largest)) is not None
    }


def late_channels(shifts: Mapping[str, TimeShift], source: str, limits: Limits) -> list[str]:
    """Channels late or early by more than the limit "shift" [s], in words. Raises InputError for a shift so large that
    the measurements cannot be of this motion."""
    said = []
    for channel, s in shifts.items():
        if not s.exceeds(limits["shift"][0]):
            continue
        size = f"{1e3 * abs(s.seconds):.0f} ms"
        size = f"at least {size}" if s.at_least else f"{size} (+- {2e3 * s.deviation:.1f})"
        verb, when = ("is", "late") if s.seconds > 0 else ("comes", "early")
        words = f"measured {channel} {verb} {size} {when} against the motion of the bones"
        if s.at_least:  # slow model errors can also end there: reported, not refused
            words += ", or a model error looks like it"
        elif s.seconds > 0:
            words += ", of which friction in the joint can be a part"
        if not s.at_least and s.exceeds(limits["shift"][1]):
            raise InputError(
                words,
                where=source,
                expected=f"less than {1e3 * limits['shift'][1]:g} ms, by the limit 'shift'",
                remedy=f"move its times by {-1e3 * s.seconds:+.0f} ms; or "
                + limit_remedy("shift", limits, abs(s.seconds)),
            )
        said.append(words)
    return said


class _Fitted(NamedTuple):
    """A fit's motion (n, c), derivatives of its residuals (n, m, p), and which residuals are used (n, m)."""

    objective: Objective
    times: Floats
    values: Floats
    slopes: Floats
    present: NDArray[np.bool_]

    def residuals(self, columns: slice, seconds: float) -> Floats:
        """Residuals (n, m) with these columns of the motion delayed."""
        moved = self.values.copy()
        late = [np.interp(self.times - seconds, self.times, v) for v in self.values[:, columns].T]
        moved[:, columns] = np.stack(late, axis=1)
        return np.where(self.present, self.objective.residuals(moved[None])[0], 0.0)


class _Whitened(NamedTuple):
    """Whitening: residuals less their prediction from the frame before, scaled; and the parameters' directions."""

    correlation: Floats  # (m,)
    size: Floats  # (m,)
    pairs: NDArray[np.bool_]  # (n - 1, m) frames present together with the one before
    q: Floats  # orthonormal basis of the parameters' effects (k, p)
    root: Floats  # (p, p) triangular factor: q root are the whitened derivatives

    @staticmethod
    def of(fit: _Fitted, r: Floats) -> _Whitened:
        """Whitening with the correlation of these residuals (n, m)."""
        pairs = fit.present[1:] & fit.present[:-1]
        squares = np.maximum(np.sum(r**2, axis=0), 1e-300)
        correlation = np.sum(np.where(pairs, r[1:] * r[:-1], 0.0), axis=0) / squares
        steps = np.where(pairs, r[1:] - correlation * r[:-1], 0.0)
        size = np.maximum(np.sqrt(np.sum(steps**2, axis=0) / np.maximum(pairs.sum(axis=0), 1)), 1e-12)
        j = fit.slopes
        directions = np.where(pairs[..., None], j[1:] - correlation[:, None] * j[:-1], 0.0) / size[:, None]
        return _Whitened(correlation, size, pairs, *np.linalg.qr(directions.reshape(-1, j.shape[-1])))

    def residuals(self, r: Floats) -> Floats:
        """Whitened residuals (k,), from residuals (n, m)."""
        return np.where(self.pairs, (r[1:] - self.correlation * r[:-1]) / self.size, 0.0).ravel()

    def change(self, z: Floats) -> Floats:
        """Change of the parameters (p,) that minimises whitened residuals."""
        return np.asarray(-np.linalg.lstsq(self.root, self.q.T @ z, rcond=None)[0], dtype=np.float64)

    def unexplained(self, z: Floats) -> Floats:
        """What a change of the parameters cannot explain (n - 1, m)."""
        return (z - self.q @ (self.q.T @ z)).reshape(self.pairs.shape)


def _shift(fit: _Fitted, columns: slice, rows: slice, largest: float) -> TimeShift | None:
    """Shift of one channel; at the end of a long search range it is `at_least` that. None if too little is known."""
    frame = float(np.median(np.diff(fit.times)))  # whole frames: between them interpolation would smooth the motion
    h = frame * max(1, int(largest / frame) // _STEPS)
    grid = h * np.arange(-int(largest / h), int(largest / h) + 1)
    unshifted = fit.residuals(columns, 0.0)
    model = _Whitened.of(fit, unshifted)
    freedom = int(model.pairs.sum()) - model.q.shape[1] - 1
    if freedom <= 0 or not model.pairs[:, rows].any():
        return None
    for _ in range(_ROUNDS):
        squares = np.array([np.sum(model.unexplained(model.residuals(fit.residuals(columns, s))) ** 2) for s in grid])
        best = int(np.argmin(squares))
        used, r = model, fit.residuals(columns, grid[best])
        at_end = best in (0, len(grid) - 1)
        if at_end:
            break
        model = _Whitened.of(fit, np.where(fit.present, r + fit.slopes @ model.change(model.residuals(r)), 0.0))
    seconds, deviation = float(grid[best]), 0.0
    if not at_end:
        below, least, above = squares[best - 1 : best + 2]
        curvature = (below - 2 * least + above) / h**2
        if not curvature > 0:
            return None
        seconds += float(0.5 * (below - above) / (h * curvature))
        deviation = float(np.sqrt(2 * least / freedom / curvature))
    one, other = used.residuals(unshifted), used.residuals(r)
    before, after = (float(np.sum(used.unexplained(z)[:, rows] ** 2)) for z in (one, other))
    late = EXPLAINED[rows.stop - rows.start == 1]
    explained, enough = 1 - after / max(before, 1e-300), late if at_end or seconds > 0 else EARLY
    if at_end and (largest < _SHORT or explained < enough):
        return None
    return TimeShift(seconds, deviation, explained, enough, used.change(other) - used.change(one), at_end)
