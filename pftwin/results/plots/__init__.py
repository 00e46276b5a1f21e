"""Figures in one house style, safe for colour-blind readers: `pftwin.results.plots.style` has it, each file beside it a
figure.

    result.plot.against_flexion().savefig("tracking.pdf")  # or .svg, or .png

Figures are matplotlib's, made without pyplot: nothing has to be closed, and no global setting is changed.
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
