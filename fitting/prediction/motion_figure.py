"""Six panels of a predicted motion: bands, the estimate's motion, and what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.prediction.predicted_motion import COORDINATES, LEVEL, PredictedMotion
from pftwin.results.plots.style import MEASURED, SMALL, house_style, legend_below, line, panels_in_rows
from pftwin.results.plots.style import title as name_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def motion_figure(motion: PredictedMotion) -> Figure:
    """Over time; frames that are not compared stand on grey."""
    with house_style():
        figure, panels = panels_in_rows(len(COORDINATES), 3, height=2.1)
        title = f"{motion.scene_name}, predicted, with bands of {100 * LEVEL:.0f} %"
        name_figure(figure, title, "; ".join(motion.notes) or None)
        for k, (ax, (unit, meaning)) in enumerate(zip(panels, COORDINATES.values(), strict=True)):
            look = line(0)
            ends = motion.low[:, k], motion.high[:, k]
            ax.fill_between(motion.times, *ends, alpha=0.25, color=look["color"], linewidth=0, label="band")
            if motion.measured is not None:
                ax.plot(motion.times, motion.measured[:, k], label=motion.label, **MEASURED)
            ax.plot(motion.times, motion.value[:, k], label="predicted", zorder=2, **look)
            for first, last in _not_compared(motion):
                ax.axvspan(first, last, color="black", alpha=0.08, linewidth=0)
            ax.set(xlabel="time [s]", ylabel=f"{meaning} [{unit}]")
            ax.yaxis.label.set_fontsize(SMALL)
        handles, labels = panels[0].get_legend_handles_labels()
        legend_below(figure, handles, labels, most=4)
    return figure


def _not_compared(motion: PredictedMotion) -> list[tuple[float, float]]:
    """Spans of time, where other frames are compared."""
    if not motion.compared.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (~motion.compared).astype(int), [0]])))
    return [(float(motion.times[a]), float(motion.times[b - 1])) for a, b in edges.reshape(-1, 2)]
