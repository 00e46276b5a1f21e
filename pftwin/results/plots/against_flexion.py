"""Tilt, shift, rotation and contact force against knee flexion: mean and standard deviation over strokes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.results.metrics import validate
from pftwin.results.plots.quantities import PlottedQuantity, provenance, quantities
from pftwin.results.plots.style import (
    BAND,
    COLOURS,
    figure_of,
    given_axes,
    house_style,
    legend_below,
    legend_entries,
    panels_in_rows,
)
from pftwin.results.plots.style import title as name_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result


LEAST = 5.0  # [deg] of knee flexion: less is no stroke
_SHARE = 0.2  # of the whole range: smaller movements back and forth belong to the stroke around them
_GRID = 181  # flexions at which strokes are averaged
Results = Any  # a Result, several of them, or either by the name in the legend
Strokes = Literal["apart", "together", "bending", "straightening"]
SHOWN = ("tilt", "shift", "rotation", "contact_force")
_WAYS: dict[str, tuple[tuple[str, tuple[bool, ...]], ...]] = {
    "apart": ((", bending", (True,)), (", straightening", (False,))),
    "together": (("", (True, False)),),
    "bending": ((", bending", (True,)),),
    "straightening": ((", straightening", (False,)),),
}
_DASHED = {", straightening": (0, (4, 1.5))}
_MEANING = "line: mean over n strokes; band: one standard deviation"


class Stroke(NamedTuple):
    """Frames of one movement in one direction, the flexion strictly rising or falling along them."""

    frames: NDArray[np.int64]
    bending: bool


class Band(NamedTuple):
    """Mean and standard deviation over strokes at each flexion, (k,) each; NaN where none of them comes."""

    flexion: Floats  # [deg]
    mean: Floats
    sd: Floats  # of one more stroke (n - 1); NaN where there is but one
    there: NDArray[np.bool_]  # (strokes, k) which of them come to which flexion

    def with_gaps(self) -> tuple[Floats, Floats, Floats]:
        """Flexion, mean and sd with NaN between flexions to which not the same strokes come: means of other things."""
        change = 1 + np.flatnonzero((self.there[:, 1:] != self.there[:, :-1]).any(axis=0))
        x, mean, sd = (np.insert(a, change, np.nan) for a in (self.flexion, self.mean, self.sd))
        return x, mean, sd


def strokes_of(flexion: Floats, where: str = "motion") -> list[Stroke]:
    """The strokes of a motion.

    Args:
        flexion: of the knee at the frames (n,) [deg].
        where: the motion's name, for the message.

    Raises:
        InputError: the knee bends by less than `LEAST`, or its flexion is not known.
    """
    known = np.isfinite(flexion)
    reach = float(np.ptp(flexion[known])) if known.any() else 0.0
    if reach < LEAST or not known.all():
        problem = f"the knee bends by {reach:.2g} deg" if known.all() else "the knee's flexion is not known everywhere"
        raise InputError(
            problem,
            where=where,
            expected=f"a motion of at least {LEAST:g} deg of knee flexion",
            remedy="draw over time: result.plot.compared(measured), or the columns of result.to_dataset()",
        )
    turns = _turning_points(flexion, max(LEAST, _SHARE * reach))
    found = []
    for first, last in pairwise(turns):
        bending = bool(flexion[last] > flexion[first])
        part = flexion[first : last + 1] if bending else -flexion[first : last + 1]
        before = np.concatenate([[-np.inf], np.maximum.accumulate(part)[:-1]])
        found.append(Stroke(first + np.flatnonzero(part > before), bending))
    return found


def _turning_points(flexion: Floats, least: float) -> list[int]:
    """Frames at which the knee turns, the first and the last extreme among them, at least `least` apart in flexion."""
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
    """Mean and standard deviation over strokes, each interpolated linearly in flexion, where they reach a flexion.

    Args:
        courses: flexion (n,), strictly rising [deg], and values (n,) of each stroke.
        grid: flexions (k,) [deg].
    """
    rows = [np.interp(grid, x, y, left=np.nan, right=np.nan) for x, y in courses]
    table = np.array(rows).reshape(len(rows), grid.size)
    there = np.isfinite(table)
    count = there.sum(axis=0)
    mean = np.where(count > 0, np.where(there, table, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    squares = np.where(there, np.square(table - mean), 0.0).sum(axis=0)
    sd = np.where(count > 1, np.sqrt(squares / np.maximum(count - 1, 1)), np.nan)
    return Band(grid, mean, sd, there)


def common_grid(flexions: Sequence[Floats]) -> Floats:
    """Flexions from the least to the largest of all [deg]."""
    return np.linspace(min(f.min() for f in flexions), max(f.max() for f in flexions), _GRID)


def against_flexion(
    results: Result | Sequence[Result] | Mapping[str, Result | Sequence[Result]],
    *,
    measured: Measured | None = None,
    show: Sequence[str] = SHOWN,
    strokes: Strokes = "apart",
    title: str | None = None,
    axes: Any = None,
) -> Figure:
    """Courses against knee flexion: a line is the mean over all strokes of a group's results, its band one sd wide.

    A stroke is a movement in one direction; a result of three cycles has three of bending and three of straightening.
    A mean is of the strokes that come to a flexion: the line is broken where their set changes, as at the ends of a
    recording; where there is one stroke alone there is no band.

    Args:
        results: one result, several that are one group (variants, draws), or groups by their names in the legend.
        measured: of the motion that was simulated: black, and labelled synthetic where they are.
        show: a panel each: of `pftwin.results.plots.quantities.QUANTITIES`.
        strokes: "apart" (bending solid, straightening dashed), "together", or "bending" or "straightening" alone.
        title: in the place of the scenes' names. That a motion is synthetic is said in any case.
        axes: as many as there are panels, to draw into; by default a new figure, two panels wide.

    Returns:
        The figure: `figure.savefig("tracking.pdf")` writes it, as do .svg and .png.

    Raises:
        InputError: no result; a knee that does not bend; a name that is not known; measurements of other frames.
    """
    groups = grouped(results)
    if strokes not in _WAYS:
        raise InputError(f"found {strokes!r}", where="strokes", expected=f"one of: {', '.join(_WAYS)}")
    panels = quantities(list(show))
    own = given_axes(axes, len(panels), f"one for each of {', '.join(panels)}")
    everything = [r for group in groups.values() for r in group]
    if measured is not None:
        validate(everything[0], measured, tibial=None, femoral=None)  # refuses other frames
    grid = common_grid([knee_flexion(r) for r in everything])
    with house_style():
        if own is None:
            figure, own = panels_in_rows(len(panels), 2, height=2.3)
            names = dict.fromkeys(r.scene_name for r in everything)
            name_figure(figure, title or "; ".join(names), _MEANING, provenance(*everything))
        for ax, quantity in zip(own, panels.values(), strict=True):
            if measured is not None:
                courses = _flexion_and_values(quantity, everything[:1], measured)
                _draw(ax, courses, grid, strokes, measured.label, "black")
            for i, (name, group) in enumerate(groups.items()):
                _draw(ax, _flexion_and_values(quantity, group), grid, strokes, name, COLOURS[i % len(COLOURS)])
            ax.set(xlabel="knee flexion [deg]", ylabel=quantity.label)
        if axes is None:
            legend_below(figure, *legend_entries(own), most=2)
    return figure_of(own[0])


def grouped(results: Results) -> dict[str, list[Result]]:
    """Groups by name.

    Raises:
        InputError: no result, or an empty group.
    """
    if isinstance(results, Mapping):
        groups = {str(k): list(v) if isinstance(v, Sequence) else [v] for k, v in results.items()}
    elif isinstance(results, Sequence):
        groups = {"simulated": list(results)}
    else:
        groups = {"simulated": [results]}
    if not groups or not all(groups.values()):
        raise InputError("nothing to draw", where="results", expected="at least one result in every group")
    return groups


def knee_flexion(result: Result) -> Floats:
    """Knee flexion at the frames, (n,) [deg]."""
    return np.degrees(np.asarray(result.knee.flexion, dtype=np.float64))


def bands(courses: list[tuple[Floats, Floats, str]], grid: Floats, way: Strokes = "apart") -> dict[str, Band]:
    """Mean and standard deviation of courses, for each way of moving, by what the legend adds.

    Args:
        courses: knee flexion (n,) [deg] and values (n,) of each recording, and its name.
        grid: flexions (k,) [deg].
        way: which strokes are averaged.
    """
    found: dict[str, list[tuple[Floats, Floats]]] = {words: [] for words, _ in _WAYS[way]}
    for flexion, values, name in courses:
        for stroke in strokes_of(flexion, name):
            order = stroke.frames if stroke.bending else stroke.frames[::-1]
            for words, which in _WAYS[way]:
                if stroke.bending in which:
                    found[words].append((flexion[order], values[order]))
    return {words: band(some, grid) for words, some in found.items()}


def _flexion_and_values(
    quantity: PlottedQuantity, group: list[Result], measured: Measured | None = None
) -> list[tuple[Floats, Floats, str]]:
    """Knee flexion and the quantity of every result that has it, or of the measurements."""
    out = []
    for result in group:
        values = quantity.simulated(result) if measured is None else quantity.measured(measured)
        flexion = knee_flexion(result)  # a knee that does not bend is refused whatever is drawn
        out.append((flexion, np.full_like(flexion, np.nan) if values is None else values, result.scene_name))
    return out


def _draw(
    ax: Axes, courses: list[tuple[Floats, Floats, str]], grid: Floats, way: Strokes, name: str, colour: str
) -> None:
    for words, found in bands(courses, grid, way).items():
        if not np.isfinite(found.mean).any():
            continue
        x, mean, sd = found.with_gaps()
        label = f"{name}{words} (n = {len(found.there)})"
        ax.plot(x, mean, label=label, linestyle=_DASHED.get(words, "-"), color=colour)
        if np.isfinite(sd).any():
            ax.fill_between(x, mean - sd, mean + sd, color=colour, **BAND)
