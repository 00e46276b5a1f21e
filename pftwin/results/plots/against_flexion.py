"""Figure of tilt, shift, rotation and contact force against knee flexion: mean and standard deviation over strokes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.results.metrics import validate
from pftwin.results.plots import style
from pftwin.results.plots.quantities import PlottedQuantity, provenance, quantities
from pftwin.results.plots.strokes import WAYS, FlexionCurve, Strokes, by_outcome, common_grid
from pftwin.results.tracking import find_dislocations, groove_offset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result

SHOWN = ("tilt", "shift", "rotation", "contact_force")
_DASHED = {", straightening": (0, (4, 1.5))}
_MEANING = "line: mean over n strokes; band: one standard deviation"
_ALONE = "thin: strokes in which the patella dislocates, each by itself; dotted from the cross on: out of its groove"
_THIN = 0.8  # line of a stroke that is not averaged [pt]


def against_flexion(
    results: Result | Sequence[Result] | Mapping[str, Result | Sequence[Result]],
    *,
    measured: Measured | None = None,
    show: Sequence[str] = SHOWN,
    strokes: Strokes = "apart",
    title: str | None = None,
    axes: Any = None,
    columns: int = 2,
) -> Figure:
    """Plots quantities against knee flexion: mean over the strokes of a group, with a band of one standard deviation.

    A stroke is a movement in one direction: a result of three cycles has three bending and three straightening strokes.
    At each flexion the mean includes the strokes that reach it. The line is broken where their set changes, as at the
    ends of a recording, and a single stroke has no band. Strokes in which the patella dislocates
    (`Result.dislocations`), even at the turning point of the knee, are never averaged: each is a thin line, dotted
    while the patella is out of its groove, with a cross where it leaves.

    Args:
        results: one result, several that form one group (variants, draws), or groups by their legend names.
        measured: measurements of the simulated motion, drawn in black; labelled if they are synthetic.
        show: quantities to draw, one panel each, from `pftwin.results.plots.quantities.QUANTITIES`.
        strokes: "apart" (bending solid, straightening dashed), "together", or only "bending" or "straightening".
        title: replaces the scenes' names. Synthetic motion is labelled in any case.
        axes: axes to draw into, one for each panel; by default a new figure.
        columns: panels next to each other in a new figure; one makes it as narrow as a phone or a journal's column.

    Returns:
        The figure; `figure.savefig("tracking.pdf")` writes it, as do .svg and .png.

    Raises:
        InputError: no result; the knee does not bend; an unknown quantity; measurements at other frames.
    """
    groups = grouped(results)
    if strokes not in WAYS:
        raise InputError(f"found {strokes!r}", where="strokes", expected=f"one of: {', '.join(WAYS)}")
    panels = quantities(list(show))
    own = style.given_axes(axes, len(panels), f"one for each of {', '.join(panels)}")
    everything = [r for group in groups.values() for r in group]
    if measured is not None:
        validate(everything[0], measured, tibial=None, femoral=None)  # refuses other frames
    grid = common_grid([knee_flexion(r) for r in everything])
    sources = [] if measured is None else [(measured.label, "black", [_source(everything[0], measured)])]
    for i, (name, group) in enumerate(groups.items()):
        sources.append((name, style.COLOURS[i % len(style.COLOURS)], [_source(r, None) for r in group]))
    with style.house_style():
        if own is None:
            figure, own = style.panels_in_rows(len(panels), columns, height=2.3 if columns > 1 else 2.0)
        alone = False
        for ax, quantity in zip(own, panels.values(), strict=True):
            for name, colour, group in sources:
                alone |= _draw(ax, [course(quantity) for course in group], grid, strokes, name, colour)
            ax.set(xlabel="knee flexion [deg]", ylabel=quantity.label)
            ax.yaxis.label.set_fontsize(style.SMALL)
        if axes is None:
            style.title(figure, title or style.scene_names(everything))
            style.footer(figure, _MEANING, _ALONE if alone else None, provenance(*everything))
            style.legend_below(figure, *style.legend_entries(own), most=2)
    return style.figure_of(own[0])


def grouped(results: Any) -> dict[str, list[Result]]:
    """Returns lists of results by group name; InputError for no result or an empty group."""
    named = results if isinstance(results, Mapping) else {"simulated": results}
    groups = {str(k): list(v) if isinstance(v, Sequence) else [v] for k, v in named.items()}
    if not groups or not all(groups.values()):
        raise InputError("nothing to draw", where="results", expected="at least one result in every group")
    return groups


def knee_flexion(result: Result) -> Floats:
    """Returns knee flexion at the frames, (n,) [deg]."""
    return np.degrees(np.asarray(result.knee.flexion, dtype=np.float64))


def _source(result: Result, measured: Measured | None) -> Callable[[PlottedQuantity], FlexionCurve]:
    """A function that returns the curve of a quantity, simulated or measured, with NaN values if it is missing."""
    flexion, out = knee_flexion(result), _dislocated(result, measured)

    def course(quantity: PlottedQuantity) -> FlexionCurve:
        y = quantity.simulated(result) if measured is None else quantity.measured(measured)
        return FlexionCurve(flexion, np.full_like(flexion, np.nan) if y is None else y, out, result.scene_name)

    return course


def _dislocated(result: Result, measured: Measured | None) -> NDArray[np.bool_]:
    """Frames in which the patella is out of its groove (n,), simulated or measured; all False without a groove.

    Also computed for INVALID motion, because drawing a stroke separately makes no claim about it.
    """
    times, groove = result.times, result.groove
    if measured is not None and groove is not None and result.surface is not None:
        times, groove = measured.times, groove_offset(result.surface, measured.center)
    return np.zeros(times.size, dtype=bool) if groove is None else find_dislocations(times, groove[1]).dislocated


def _draw(ax: Axes, courses: list[FlexionCurve], grid: Floats, way: Strokes, name: str, colour: str) -> bool:
    """Draws the curves of one group; returns whether a stroke among them dislocates."""
    dislocates = False
    for words, (found, alone) in by_outcome(courses, grid, way).items():
        dashes = _DASHED.get(words, "-")
        if np.isfinite(found.mean).any():
            x, mean, sd = found.with_gaps()
            ax.plot(x, mean, label=f"{name}{words} (n = {len(found.there)})", linestyle=dashes, color=colour)
            if np.isfinite(sd).any():
                ax.fill_between(x, mean - sd, mean + sd, color=colour, **style.BAND)
        if any(np.isfinite(course.values).any() for course in alone):
            _draw_alone(ax, alone, f"{name}{words}, dislocates (n = {len(alone)})", dashes, colour)
            dislocates = True
    return dislocates


def _draw_alone(ax: Axes, strokes: list[FlexionCurve], label: str, dashes: Any, colour: str) -> None:
    """Draws single strokes with gaps between them; the solid and dotted parts share the frame where they meet."""
    x, y = (np.concatenate([np.append(c[k], np.nan) for c in strokes]) for k in (0, 1))
    out = np.concatenate([np.append(c.out, False) for c in strokes])
    leaves, back = (
        np.concatenate([np.r_[False, way[1:] & ~way[:-1], False] for way in ways])
        for ways in ([c.out for c in strokes], [~c.out for c in strokes])
    )
    ax.plot(x, np.where(out & ~leaves, np.nan, y), linestyle=dashes, linewidth=_THIN, color=colour)
    ax.plot(
        x, np.where(out | back, y, np.nan), linestyle=":", color=colour, label=label,
        marker="x" if leaves.any() else None, markevery=[int(i) for i in np.flatnonzero(leaves)],
    )  # fmt: skip
