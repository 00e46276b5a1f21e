"""Figures of a fit: measured against fitted, how the parameters hang together, and the way there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fitting.estimate import Estimate


class EstimatePlots:
    """`estimate.plot`: each method gives a matplotlib figure."""

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate

    def fit(self) -> Figure:
        """The measured trajectory, the nominal and the fitted one.

        Raises:
            InputError: an estimate from a file, which holds neither scene nor measurements.
        """
        import pftwin
        from pftwin.plots import case_figure

        e = self._estimate
        if e.nominal_scene is None or e.measured is None:
            raise InputError("an estimate from a file holds no measurements to draw")
        results = {"nominal": pftwin.simulate(e.nominal_scene), "fitted": pftwin.simulate(e.scene)}
        return case_figure(results, e.measured, f"{e.scene_name}: {e.method}, objective {e.objective}")

    def correlation(self) -> Figure:
        """Correlations of the parameters' errors, and relative standard deviations."""
        import matplotlib as mpl
        from matplotlib.figure import Figure

        from pftwin.plots import COLOURS, STYLE

        e = self._estimate
        p = len(e.names)
        with mpl.rc_context({**STYLE, "axes.grid": False}):
            figure = Figure(figsize=(9.0, 4.0))
            left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.2])
            picture = left.imshow(e.correlation, vmin=-1, vmax=1, cmap="RdBu_r")
            left.set_xticks(range(p), e.names, rotation=90 if p > 6 else 0)
            left.set_yticks(range(p), e.names)
            for i in range(p if p <= 8 else 0):
                for j in range(p):
                    strong = abs(e.correlation[i, j]) > 0.6
                    colour = "white" if strong else "black"
                    left.text(j, i, f"{e.correlation[i, j]:.2f}", ha="center", va="center", color=colour)
            figure.colorbar(picture, ax=left, label="correlation", shrink=0.8)
            left.set_title("Correlation of the parameters' errors")
            scale = np.where(e.nominal == 0, 1.0, np.abs(e.nominal))
            off = 100 * (e.values - e.nominal) / scale
            spread = 100 * (e.intervals - e.values[:, None]) / scale[:, None]
            right.errorbar(
                off, np.arange(p), xerr=np.abs(spread).T, fmt="o", color=COLOURS[0], capsize=3, label="95 % interval"
            )
            right.axvline(0, color="black", linewidth=0.8)
            right.set_yticks(range(p), e.names)
            right.invert_yaxis()
            right.set(xlabel="deviation from the nominal value [%]", title="Estimate")
            right.legend(loc="best")
            figure.suptitle(f"{e.scene_name}, fitted to {'synthetic measurements' if e.synthetic else e.source}")
        return figure

    def history(self) -> Figure:
        """The best objective so far against the evaluations."""
        import matplotlib as mpl
        from matplotlib.figure import Figure

        from pftwin.plots import COLOURS, STYLE

        e = self._estimate
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(6.0, 3.6))
            axes = figure.subplots()
            known = [h for h in e.history if np.isfinite(h["best"])]
            axes.plot([h["evaluations"] for h in known], [h["best"] for h in known], color=COLOURS[0])
            axes.set(xlabel="evaluations", ylabel=f"objective [{e.objective_unit}]", title=f"{e.method}: best so far")
        return figure

    def save(self, stem: Path) -> list[Path]:
        """All figures as STEM_fit.png, STEM_correlation.png, STEM_history.png, and as SVG.

        Raises:
            OutputError: the folder is missing or cannot be written to.
        """
        from pftwin.plots import save_figure

        drawn: dict[str, Any] = {"fit": self.fit, "correlation": self.correlation, "history": self.history}
        written: list[Path] = []
        for name, draw in drawn.items():
            written += save_figure(draw(), stem.with_name(f"{stem.name}_{name}"))
        return written
