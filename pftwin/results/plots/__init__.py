"""Matplotlib figures of results, in one colour-blind-safe style (`pftwin.results.plots.style`).

    result.plot.against_flexion().savefig("tracking.pdf")  # or .svg, or .png

Figures are made without pyplot: they need not be closed, and matplotlib's global settings do not change.
"""

from __future__ import annotations

from pftwin.results.plots.accessor import ResultPlots
from pftwin.results.plots.against_flexion import against_flexion
from pftwin.results.plots.compared import case_figure, compared
from pftwin.results.plots.style import COLOURS, STYLE, house_style, save_figure
from pftwin.results.plots.trajectory import trajectory

__all__ = [
    "COLOURS",
    "STYLE",
    "ResultPlots",
    "against_flexion",
    "case_figure",
    "compared",
    "house_style",
    "save_figure",
    "trajectory",
]
