"""Tilt, shift, rotation and contact force against knee flexion: mean and standard deviation over cycles or variants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.results.metrics import validate
from pftwin.results.plots.flexion_cycles import Band, band, common_grid, strokes_of
from pftwin.results.plots.panels import entries, figure_of, given_axes, panels_in_rows
from pftwin.results.plots.quantities import PlottedQuantity, provenance, quantities
from pftwin.results.plots.style import BAND, COLOURS, house_style, legend_below
from pftwin.results.plots.style import title as name_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result

Floats = NDArray[np.float64]
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
                courses = _of(quantity, everything[:1], measured)
                _draw(ax, courses, grid, strokes, measured.label, "black")
            for i, (name, group) in enumerate(groups.items()):
                _draw(ax, _of(quantity, group), grid, strokes, name, COLOURS[i % len(COLOURS)])
            ax.set(xlabel="knee flexion [deg]", ylabel=quantity.label)
        if axes is None:
            legend_below(figure, *entries(own), most=2)
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
    """Of the knee at the frames, (n,) [deg]."""
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


def _of(
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
