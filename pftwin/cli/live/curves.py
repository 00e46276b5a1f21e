"""Tilt, shift and contact force over time, untreated and treated, with a mark at the time that is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.cli.live.answer import Answer
from pftwin.plots import COLOURS

if TYPE_CHECKING:
    from viser import GuiApi

HEIGHT = 165  # of a chart [pixels]
BEFORE, AFTER = COLOURS[:2]
Floats = NDArray[np.float64]


class Curves:
    """The charts."""

    def __init__(self, gui: GuiApi, before: Answer) -> None:
        self._before = self._after = before
        self._charts = {
            name: gui.add_uplot(
                self._data(name, 0),
                (
                    {"label": "time [s]"},
                    {"label": "untreated", "stroke": BEFORE, "width": 1.5},
                    {"label": "treated", "stroke": AFTER, "width": 2},
                    {"label": "now", "stroke": "#222222", "points": {"show": True, "size": 9, "fill": AFTER}},
                ),
                title=title,
                scales={"x": {"time": False}},
                axes=({"label": "time [s]", "labelSize": 18, "size": 32}, {"size": 46}),
                legend={"show": False},
                cursor={"drag": {"x": False, "y": False}},
                height=HEIGHT,
                padding=(4, 14, 0, 0),
            )
            for name, title in (("tilt", "tilt [°]"), ("shift", "shift [mm]"), ("force", "contact force [N]"))
        }

    def set(self, before: Answer, after: Answer, k: int) -> None:
        """Draws other motions."""
        self._before, self._after = before, after
        self.mark(k)

    def mark(self, k: int) -> None:
        """Moves the mark to a frame of the treated motion."""
        for name, chart in self._charts.items():
            chart.data = self._data(name, k)

    def _data(self, name: str, k: int) -> tuple[Floats, ...]:
        series: list[Any] = [getattr(a, name) for a in (self._before, self._after)]
        times = self._after.times
        mark = np.full_like(times, np.nan)
        mark[k] = series[1][k]
        return times, _at(times, self._before.times, series[0]), series[1], mark


def _at(times: Floats, own: Floats, values: Floats) -> Floats:
    """Values at other times, where their own ones are not the same."""
    return values if own.shape == times.shape and np.allclose(own, times) else np.interp(times, own, values)
