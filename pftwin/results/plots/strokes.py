"""Strokes, which are movements of the knee in one direction, and averages over those without dislocation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError

LEAST = 5.0  # smallest range of knee flexion of a stroke [deg]
_SHARE = 0.2  # of the whole range: smaller reversals belong to the stroke around them
_GRID = 181  # number of flexions at which strokes are averaged
Strokes = Literal["apart", "together", "bending", "straightening"]
WAYS: dict[str, tuple[tuple[str, tuple[bool, ...]], ...]] = {
    "apart": ((", bending", (True,)), (", straightening", (False,))),
    "together": (("", (True, False)),),
    "bending": ((", bending", (True,)),),
    "straightening": ((", straightening", (False,)),),
}


class FlexionCurve(NamedTuple):
    """A quantity over a recording's n frames."""

    flexion: Floats  # (n,) of the knee [deg]
    values: Floats  # (n,)
    out: NDArray[np.bool_]  # (n,) whether the patella is out of its groove
    name: str


class Stroke(NamedTuple):
    """One movement of the knee in one direction."""

    frames: NDArray[np.int64]  # subset along which the flexion strictly rises or falls
    bending: bool
    whole: slice  # all its frames, with small reversals and the pauses at its ends, which neighbours share


class Band(NamedTuple):
    """Mean and standard deviation over strokes at each flexion, (k,) each; NaN where no stroke reaches it."""

    flexion: Floats  # [deg]
    mean: Floats
    sd: Floats  # sample standard deviation (n - 1); NaN for a single stroke
    there: NDArray[np.bool_]  # (strokes, k) which stroke reaches which flexion

    def with_gaps(self) -> tuple[Floats, Floats, Floats]:
        """Returns flexion, mean and sd with NaN inserted where the set of averaged strokes changes."""
        change = 1 + np.flatnonzero((self.there[:, 1:] != self.there[:, :-1]).any(axis=0))
        x, mean, sd = (np.insert(a, change, np.nan) for a in (self.flexion, self.mean, self.sd))
        return x, mean, sd


def strokes_of(flexion: Floats, where: str = "motion") -> list[Stroke]:
    """Splits a motion into strokes from knee flexion (n,) [deg]; every frame is in the `whole` of a stroke.

    Raises InputError, which names the motion `where`, if the knee bends by less than `LEAST` or flexion is missing.
    """
    known = np.isfinite(flexion)
    span = float(np.ptp(flexion[known])) if known.any() else 0.0
    if span < LEAST or not known.all():
        problem = f"the knee bends by {span:.2g} deg" if known.all() else "the knee's flexion is not known everywhere"
        raise InputError(
            problem,
            where=where,
            expected=f"a motion of at least {LEAST:g} deg of knee flexion",
            remedy="draw over time: result.plot.compared(measured), or the columns of result.to_dataset()",
        )
    turns = _turning_points(flexion, max(LEAST, _SHARE * span))
    advancing, ways = [], []
    for first, last in pairwise(turns):
        ways.append(bool(flexion[last] > flexion[first]))
        part = flexion[first : last + 1] if ways[-1] else -flexion[first : last + 1]
        before = np.concatenate([[-np.inf], np.maximum.accumulate(part)[:-1]])
        advancing.append(first + np.flatnonzero(part > before))
    begins = [0, *(int(frames[-2]) + 1 for frames in advancing[:-1])]
    ends = [*(int(frames[1]) for frames in advancing[1:]), flexion.size]
    return [Stroke(*each) for each in zip(advancing, ways, map(slice, begins, ends), strict=True)]


def _turning_points(flexion: Floats, least: float) -> list[int]:
    """Frames of the flexion's extremes, first and last included, that differ by at least `least` [deg]."""
    points: list[int] = []
    rising: bool | None = None
    low = high = 0
    for i, value in enumerate(flexion):
        low, high = (i if value < flexion[low] else low), (i if value > flexion[high] else high)
        if rising is not True and value - flexion[low] >= least:
            points, rising, high = [*points, low], True, i
        elif rising is not False and flexion[high] - value >= least:
            points, rising, low = [*points, high], False, i
    return [*points, high if rising else low]


def band(courses: Sequence[tuple[Floats, Floats]], grid: Floats) -> Band:
    """Averages strokes at flexions `grid` (k,) [deg]; a stroke counts only at flexions that it reaches.

    Each of `courses` is flexion (n,), strictly rising [deg], and values (n,), interpolated linearly.
    """
    rows = [np.interp(grid, x, y, left=np.nan, right=np.nan) for x, y in courses]
    table = np.ma.masked_invalid(np.array(rows).reshape(len(rows), grid.size))
    mean, sd = (found.filled(np.nan) for found in (table.mean(axis=0), table.std(axis=0, ddof=1)))
    return Band(grid, mean, sd, ~np.ma.getmaskarray(table))


def common_grid(flexions: Sequence[Floats]) -> Floats:
    """Returns evenly spaced flexions from the minimum to the maximum of all recordings [deg]."""
    return np.linspace(min(f.min() for f in flexions), max(f.max() for f in flexions), _GRID)


class Averaged(NamedTuple):
    """The strokes of one direction, averaged only over those without dislocation.

    A patella that is out of its groove while the knee turns or pauses counts as dislocated in both strokes.
    """

    band: Band  # average of the strokes in which the patella stays in its groove in every frame
    alone: list[FlexionCurve]  # the other strokes, with all their frames in order of time


def by_outcome(courses: Sequence[FlexionCurve], grid: Floats, way: Strokes = "apart") -> dict[str, Averaged]:
    """Averages the strokes of recordings at flexions (k,) [deg], by direction; the keys are suffixes of the legend."""
    averaged: dict[str, list[tuple[Floats, Floats]]] = {words: [] for words, _ in WAYS[way]}
    alone: dict[str, list[FlexionCurve]] = {words: [] for words, _ in WAYS[way]}
    for flexion, values, out, name in courses:
        for frames, bending, whole in strokes_of(flexion, name):
            for words in (words for words, which in WAYS[way] if bending in which):
                if out[whole].any():
                    alone[words].append(FlexionCurve(flexion[whole], values[whole], out[whole], name))
                else:
                    rising = frames if bending else frames[::-1]
                    averaged[words].append((flexion[rising], values[rising]))
    return {words: Averaged(band(averaged[words], grid), alone[words]) for words in averaged}
