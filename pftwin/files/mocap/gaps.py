"""Short gaps in marker trajectories are filled by a spline, long ones refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.markers import MarkerTrajectories


@dataclass(frozen=True)
class Gap:
    """A run of frames, counted from 0 and both included, in which a marker was not seen."""

    marker: str
    first_frame: int
    last_frame: int
    filled: bool

    @property
    def frames(self) -> int:
        """Length of the gap."""
        return self.last_frame - self.first_frame + 1


def find_gaps(markers: MarkerTrajectories) -> list[Gap]:
    """Every gap of every marker, in the order of markers and time."""
    gaps = []
    for name, missing in zip(markers.names, markers.missing.T, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
        gaps += [Gap(name, int(a), int(b) - 1, False) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return gaps


def fill_gaps(
    markers: MarkerTrajectories, *, max_gap_s: float = 0.1, keep_long: bool = False
) -> tuple[MarkerTrajectories, list[Gap]]:
    """Fill interior gaps by the cubic spline through the frames around them; `select` the markers needed first.

    Args:
        markers: the recording.
        max_gap_s: longest gap that is filled [s] (duration of the missing frames).
        keep_long: leave gaps that cannot be filled as NaN instead of refusing (`cluster_poses` can do without).

    Returns:
        The filled markers, and every gap that was found, each with `filled`.

    Raises:
        InputError: a gap longer than `max_gap_s` or at the recording's start or end, naming marker and frames.
    """
    if not max_gap_s >= 0:
        raise InputError(
            f"the longest gap to fill is {max_gap_s}", where="max_gap_s", expected="a duration of 0 s or more"
        )
    gaps = find_gaps(markers)
    if not gaps:
        return markers, []
    limit = int(np.floor(max_gap_s * markers.rate + 1e-9)) if markers.times.size > 1 else 0
    last = markers.times.size - 1
    seen = dict(zip(markers.names, (~markers.missing).sum(axis=0), strict=True))
    report = [Gap(g.marker, g.first_frame, g.last_frame, _fillable(g, limit, last, int(seen[g.marker]))) for g in gaps]
    refused = [g for g in report if not g.filled]
    if refused and not keep_long:
        raise _refusal(refused, limit, last, max_gap_s, markers)
    positions = markers.positions.copy()
    for column, name in enumerate(markers.names):
        frames = [f for g in report if g.marker == name and g.filled for f in range(g.first_frame, g.last_frame + 1)]
        if frames:
            positions[frames, column] = _spline(markers.times, positions[:, column], frames)
    return markers.with_positions(positions), report


def _fillable(gap: Gap, limit: int, last: int, seen: int) -> bool:
    return gap.first_frame > 0 and gap.last_frame < last and gap.frames <= limit and seen >= 4


def _spline(times: NDArray[np.float64], trajectory: NDArray[np.float64], frames: list[int]) -> NDArray[np.float64]:
    from scipy.interpolate import CubicSpline

    seen = np.isfinite(trajectory[:, 0])
    return CubicSpline(times[seen], trajectory[seen])(times[frames])


def _refusal(gaps: list[Gap], limit: int, last: int, max_gap_s: float, markers: MarkerTrajectories) -> InputError:
    def text(g: Gap) -> str:
        at_end = " at the start" if g.first_frame == 0 else " at the end" if g.last_frame == last else ""
        if g.frames > last:
            return f"{g.marker!r} is never seen"
        return f"{g.marker!r} frames {g.first_frame} to {g.last_frame}{at_end}"

    listed = "; ".join(text(g) for g in gaps[:6]) + (f"; and {len(gaps) - 6} more" if len(gaps) > 6 else "")
    return InputError(
        f"gaps that cannot be filled: {listed} (frames counted from 0)",
        where=markers.source,
        expected=f"gaps of at most {max_gap_s:g} s ({limit} frames), not at the ends",
        remedy="fewer markers (select), a part of the recording (between), or a larger max_gap_s",
    )
