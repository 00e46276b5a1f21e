"""Figures in one house style, safe for colour-blind readers: `pftwin.plots.style` has it, each file beside it a figure.

    result.plot.against_flexion().savefig("tracking.pdf")  # or .svg, or .png

Figures are matplotlib's, made without pyplot: nothing has to be closed, and no global setting is changed.
"""

from __future__ import annotations

from pftwin.plots.accessor import ResultPlots
from pftwin.plots.against_flexion import against_flexion
from pftwin.plots.case import case_figure
from pftwin.plots.compared import compared
from pftwin.plots.saving import save_figure
from pftwin.plots.style import COLOURS, STYLE, house_style
from pftwin.plots.trajectory import trajectory

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
