"""Charts of the live page: tilt, shift and contact force over time, or for each stroke against knee flexion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.cli.live.motion import AS_SET, UNTREATED, Band, Floats, ShownMotion
from fitting.cli.live.words import AFTER, BEFORE
from pftwin.base.errors import InputError
from pftwin.results.plots.strokes import strokes_of

if TYPE_CHECKING:
    from viser import GuiApi

CHART = 142  # height of a chart [pixels]
EDGES = 5.0  # limits of the vertical axes are multiples of this [deg, mm or N]
NAMES = {"tilt": "tilt [°]", "shift": "shift [mm]", "force": "contact force [N]"}
SOLID, DASHED, DOTTED = (), (9.0, 5.0), (2.0, 4.0)
AGAINST = "solid: bending; dashed: straightening; dotted: the patella is out of its groove"
_FAINT = f"{AFTER}38"


class Piece(NamedTuple):
    """Consecutive frames along which the abscissa increases, and the dash pattern of their line."""

    frames: NDArray[np.int64]
    dash: tuple[float, ...]


def pieces(motion: ShownMotion, *, against_flexion: bool) -> list[Piece]:
    """Splits a motion into lines: one line over time; against flexion, one or more per stroke, split where the patella
    leaves or re-enters its groove. Raises InputError for a motion without a stroke."""
    if not against_flexion:
        return [Piece(np.arange(motion.times.size), SOLID)]
    found = []
    for frames, bending, _ in strokes_of(motion.flexion):
        for run in np.split(frames, 1 + np.flatnonzero(np.diff(motion.out[frames]))):
            dash = DOTTED if motion.out[run[0]] else SOLID if bending else DASHED
            found.append(Piece(run if bending else run[::-1], dash))
    return found


def why_not_against_flexion(motion: ShownMotion) -> str:
    """The reason why a motion cannot be drawn against flexion; empty if it can."""
    try:
        pieces(motion, against_flexion=True)
    except InputError as error:
        return error.problem
    return ""


class Curves:
    """Charts of the treated motion, optionally of the untreated one, with bands and a mark at the current time."""

    def __init__(self, gui: GuiApi, before: ShownMotion) -> None:
        self._before = self._after = before
        self._band: Band | None = None
        self._compared = self._against_flexion = False
        self._drawn: dict[str, Any] = {}
        for name in NAMES:
            props, data = self._content(name, 0)
            chart = gui.add_uplot(
                data,
                **props,
                axes=({"size": 24}, {"size": 42}),
                legend={"show": False},
                cursor={"drag": {"x": False, "y": False}},
                height=CHART,
                padding=(4, 14, 0, 0),
            )
            self._drawn[name] = chart, props

    def set(
        self, before: ShownMotion, after: ShownMotion, band: Band | None, *, compared: bool, against_flexion: bool
    ) -> None:
        """Sets the motions and the band to draw at the next `mark`; the untreated one is drawn only if `compared`."""
        self._before, self._after, self._band = before, after, band
        self._compared, self._against_flexion = compared, against_flexion

    def mark(self, k: int) -> None:
        """Draws the motions that were set, with the mark at a frame of the treated motion."""
        for name, (chart, drawn) in self._drawn.items():
            props, data = self._content(name, k)
            for prop in (p for p in props if props[p] != drawn[p]):  # each makes the page rebuild the chart
                setattr(chart, prop, props[prop])
            chart.data = data
            self._drawn[name] = chart, props

    def _content(self, name: str, k: int) -> tuple[dict[str, Any], tuple[Floats, ...]]:
        """Properties of a chart, and its data series: abscissa, ends of bands, lines, mark."""
        along = self._after.flexion if self._against_flexion else self._after.times
        grid, at = np.unique(along, return_inverse=True)
        series: list[dict[str, Any]] = [{"label": "knee flexion [°]" if self._against_flexion else "time [s]"}]
        data, bands = [grid], []

        def add(piece: Piece, values: Floats, look: dict[str, Any]) -> None:
            x, y = along[piece.frames], values[piece.frames]
            data.append(np.interp(grid, x, y, left=np.nan, right=np.nan))
            series.append({**look, "dash": piece.dash})

        lines = pieces(self._after, against_flexion=self._against_flexion)
        ends = () if self._band is None else self._band.ends.get(name, ())
        for piece in lines if ends else ():
            for end in ends:
                add(piece, end, {"label": "band", "stroke": _FAINT, "width": 1, "points": {"show": False}})
            bands.append({"series": (len(data) - 1, len(data) - 2), "fill": _FAINT})
        if self._compared:
            for piece in pieces(self._before, against_flexion=self._against_flexion):
                look = {"label": UNTREATED, "stroke": BEFORE, "width": 1.5, "points": {"show": False}}
                add(piece, getattr(self._before, name), look)
        for piece in lines:
            look = {"label": AS_SET, "stroke": AFTER, "width": 2, "points": {"show": False}}
            add(piece, getattr(self._after, name), look)
        mark = np.full_like(grid, np.nan)
        mark[at[k]] = getattr(self._after, name)[k]
        look = {"label": "now", "stroke": "#222222", "points": {"show": True, "size": 9, "fill": AFTER}}
        words = "against knee flexion [°]" if self._against_flexion else "over time [s]"
        props = {
            "series": (*series, look),
            "bands": tuple(bands),
            "title": f"{NAMES[name]} {words}",
            "scales": self._scales(data[1:]),
        }
        return props, (*data, mark)

    def _scales(self, data: list[Floats]) -> Any:
        """Scales of both axes, with limits rounded outwards so that small moves of a slider do not change them.

        They are explicit, because uPlot finds no range for a mark, which is missing (NaN) at all frames but one.
        """
        values = np.concatenate(data)
        finite = values[np.isfinite(values)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        edges = EDGES * np.floor(low / EDGES - 0.05), EDGES * np.ceil(high / EDGES + 0.05)
        return {"x": {"time": False}, "y": {"range": tuple(float(e) for e in edges)}}
