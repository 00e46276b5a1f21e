"""Figures of a calibration: coverage against the nominal level, and histograms of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fitting.calibration.result import Calibration

_BINS = 10
_GRID = np.linspace(0.05, 0.99, 48)


class CalibrationPlots:
    """`calibration.plot`: each method returns a matplotlib figure."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration

    def coverage(self) -> Figure:
        """Share of intervals that contain the true value, against their level, a panel for each kind of plants."""
        from matplotlib.figure import Figure

        from pftwin.results.plots.style import COLOURS, DASHES, PAGE, house_style

        c = self._calibration
        with house_style():
            figure = Figure(figsize=(PAGE, 2.4))
            panels = figure.subplots(1, len(c.kinds), sharey=True, squeeze=False)[0]
            for ax, (kind, answers) in zip(panels, c.kinds.items(), strict=True):
                ax.plot([0, 1], [0, 1], color="black", linewidth=0.7)
                for i, name in enumerate(c.names):
                    coverages = [answers.covered(level)[:, i].mean() for level in _GRID] if len(answers.ranks) else []
                    style = {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)]}
                    ax.plot(_GRID[: len(coverages)], coverages, label=name, **style)
                ax.set(title=f"{kind}: {len(answers.ranks)} plants", xlabel="level", xlim=(0, 1), ylim=(0, 1))
                ax.set_aspect("equal")
            panels[0].set_ylabel("coverage")
            figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=len(c.names))
        return figure

    def ranks(self) -> Figure:
        """Histograms of the true value's rank among the draws: flat if intervals are calibrated."""
        from matplotlib.figure import Figure

        from pftwin.results.plots.style import COLOURS, PAGE, house_style

        c = self._calibration
        rows, columns = len(c.kinds), len(c.names)
        with house_style():
            figure = Figure(figsize=(PAGE, 1.1 * rows + 0.6))
            panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
            for row, (kind, answers) in zip(panels, c.kinds.items(), strict=True):
                expected = len(answers.ranks) / _BINS
                for ax, name, ranks in zip(row, c.names, answers.ranks.T, strict=True):
                    ax.hist(ranks, bins=_BINS, range=(0, 1), color=COLOURS[0])
                    ax.axhspan(*_usual(len(ranks), expected), color="black", alpha=0.15, linewidth=0)
                    ax.set(title=f"{name}, {kind}", xlim=(0, 1), yticks=[])
            for ax in panels[-1]:
                ax.set_xlabel("rank of the true value")
        return figure

    def save(self, stem: Path) -> list[Path]:
        """Saves both as STEM_coverage and STEM_ranks, .png and .svg. Raises OutputError if the folder is missing or
        cannot be written to."""
        from pftwin.results.plots import save_figure

        drawn = {"coverage": self.coverage(), "ranks": self.ranks()}
        return [p for what, figure in drawn.items() for p in save_figure(figure, stem.with_name(f"{stem.name}_{what}"))]


def _usual(count: int, expected: float) -> tuple[float, float]:
    """Range of heights that contains 95 % of the bars if ranks are uniform."""
    from scipy.stats import binom

    low, high = binom.interval(0.95, max(count, 1), 1 / _BINS)
    return (float(low), float(high)) if count else (expected, expected)
