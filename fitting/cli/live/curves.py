"""Tilt, shift and contact force over time, treated and if asked for untreated, with a mark at the time shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.live.motion import Floats, ShownMotion
from fitting.cli.live.words import AFTER, BEFORE

if TYPE_CHECKING:
    from viser import GuiApi

HEIGHT = 142  # of a chart [pixels]
ROUND = 5.0  # edges of the charts are multiples of this, in degrees, mm or newtons


class Curves:
    """The charts."""

    def __init__(self, gui: GuiApi, before: ShownMotion) -> None:
        self._before = self._after = before
        self._compared = False
        names = (("tilt", "tilt [°]"), ("shift", "shift [mm]"), ("force", "contact force [N]"))
        self._drawn = {name: self._scales(name) for name, _ in names}
        self._charts = {
            name: gui.add_uplot(
                self._data(name, 0),
                (
                    {"label": "time [s]"},
                    {"label": "untreated", "stroke": BEFORE, "width": 1.5},
                    {"label": "treated", "stroke": AFTER, "width": 2},
                    {"label": "now", "stroke": "#222222", "points": {"show": True, "size": 9, "fill": AFTER}},
                ),
                title=f"{title} over time [s]",
                scales=self._drawn[name],
                axes=({"size": 24}, {"size": 42}),
                legend={"show": False},
                cursor={"drag": {"x": False, "y": False}},
                height=HEIGHT,
                padding=(4, 14, 0, 0),
            )
            for name, title in names
        }

    def set(self, before: ShownMotion, after: ShownMotion, *, compared: bool) -> None:
        """Takes other motions, which are drawn with the next mark; the untreated one only if they are compared."""
        self._before, self._after, self._compared = before, after, compared
        for name, chart in self._charts.items():
            if (scales := self._scales(name)) != self._drawn[name]:  # new scales make a page rebuild its chart
                chart.scales = self._drawn[name] = scales

    def mark(self, k: int) -> None:
        """Moves the mark to a frame of the treated motion."""
        for name, chart in self._charts.items():
            chart.data = self._data(name, k)

    def _scales(self, name: str) -> Any:
        """Both axes, rounded outwards so that they stay while a slider is moved a little.

        uPlot would find no range for a mark that is at one place and missing (NaN) elsewhere.
        """
        shown = (self._before, self._after) if self._compared else (self._after,)
        values = np.concatenate([getattr(a, name) for a in shown])
        there = values[np.isfinite(values)]
        low, high = (float(there.min()), float(there.max())) if there.size else (0.0, 1.0)
        edges = ROUND * np.floor(low / ROUND - 0.05), ROUND * np.ceil(high / ROUND + 0.05)
        return {"x": {"time": False}, "y": {"range": tuple(float(e) for e in edges)}}

    def _data(self, name: str, k: int) -> tuple[Floats, ...]:
        series: list[Any] = [getattr(a, name) for a in (self._before, self._after)]
        times = self._after.times
        mark = np.full_like(times, np.nan)
        mark[k] = series[1][k]
        before, own = series[0] if self._compared else np.full_like(times, np.nan), self._before.times
        if self._compared and not (own.shape == times.shape and np.allclose(own, times)):
            before = np.interp(times, own, before)
        return times, before, series[1], mark
