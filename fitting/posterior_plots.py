"""Figures of a posterior: all pairs of parameters, with the estimate's normal distribution over them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fitting.posterior import Posterior

_BINS = 40
_TWICE = (1.0, 2.0)  # ellipses drawn of the estimate, in standard deviations
_SIDE = 2.0  # of a panel [in]


class PosteriorPlots:
    """`posterior.plot`: each method gives a matplotlib figure."""

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def corner(self) -> Figure:
        """Histograms of every parameter, draws of every pair; lines and ellipses are the estimate's."""
        import matplotlib as mpl
        from matplotlib.figure import Figure

        from pftwin.plots import COLOURS, STYLE

        p, e = self._posterior, self._posterior.estimate
        flat, count = p.draws.reshape(-1, len(p.names)), len(p.names)
        with mpl.rc_context({**STYLE, "axes.grid": False}):
            figure = Figure(figsize=(1.5 + _SIDE * count, 1.5 + _SIDE * count))
            panels = figure.subplots(count, count, squeeze=False, sharex="col")
            for i in range(count):
                for j in range(count):
                    axes: Any = panels[i, j]
                    if j > i:
                        axes.set_axis_off()
                    elif i == j:
                        self._marginal(axes, flat[:, i], i)
                    else:
                        axes.plot(flat[:, j], flat[:, i], ",", color=COLOURS[0], alpha=0.35, rasterized=True)
                        for size in _TWICE:
                            axes.plot(*_ellipse(e.values, e.covariance, j, i, size), color=COLOURS[1])
                    if i == count - 1:
                        axes.set_xlabel(_label(p, j))
                        axes.tick_params(axis="x", labelrotation=45)
                    if i > 0 and j == 0:
                        axes.set_ylabel(_label(p, i))
                    elif i != j:
                        axes.tick_params(labelleft=False)
            against = "synthetic measurements" if e.synthetic else e.source
            figure.suptitle(f"{e.scene_name}: posterior given {against}\n{p.sentence()}", wrap=True)
            figure.legend(*_legend(), loc="upper right", bbox_to_anchor=(0.98, 0.9))
        return figure

    def _marginal(self, axes: Any, values: Any, i: int) -> None:
        from pftwin.plots import COLOURS

        e = self._posterior.estimate
        axes.hist(values, bins=_BINS, density=True, color=COLOURS[0], alpha=0.5)
        mean, sd = e.values[i], e.standard_deviations[i]
        x = np.linspace(mean - 4 * sd, mean + 4 * sd, 200)
        x = x[(x >= e.lower[i]) & (x <= e.upper[i])]
        axes.plot(x, np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi)), color=COLOURS[1])
        axes.set_yticks([])

    def save(self, stem: Path) -> list[Path]:
        """The figure as STEM_posterior.png and STEM_posterior.svg.

        Raises:
            OutputError: the folder is missing or cannot be written to.
        """
        from pftwin.plots import save_figure

        return list(save_figure(self.corner(), stem.with_name(f"{stem.name}_posterior")))


def _label(posterior: Posterior, i: int) -> str:
    return f"{posterior.names[i]} [{posterior.units[i]}]"


def _legend() -> tuple[list[Any], list[str]]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from pftwin.plots import COLOURS

    drawn = [Patch(color=COLOURS[0], alpha=0.5), Line2D([], [], color=COLOURS[1])]
    return drawn, ["posterior", "estimate: normal; 1 and 2 standard deviations"]


def _ellipse(mean: Any, covariance: Any, i: int, j: int, size: float) -> tuple[Any, Any]:
    """Of two parameters' normal distribution, at so many standard deviations."""
    part = covariance[np.ix_([i, j], [i, j])]
    values, vectors = np.linalg.eigh(part)
    angle = np.linspace(0, 2 * np.pi, 100)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    x, y = size * (vectors * np.sqrt(np.maximum(values, 0))) @ circle
    return mean[i] + x, mean[j] + y
