"""Figures of a posterior: all pairs of parameters, with the estimate's normal distribution over them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import as_read

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.estimate import Estimate
    from fitting.posterior.result import Posterior


_BINS = 40
_TWICE = (1.0, 2.0)  # sizes of the estimate's ellipses, in standard deviations
_SIDE = 1.6  # side of a panel [in]


class PosteriorPlots:
    """`posterior.plot`: each method returns a matplotlib figure."""

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def corner(self) -> Figure:
        """Histograms of every parameter, draws of every pair; lines and ellipses show the estimate."""
        return corner_figure(self._posterior.estimate, self._posterior)

    def save(self, stem: Path) -> list[Path]:
        """Saves the figure as STEM_posterior.png and STEM_posterior.svg. Raises OutputError if the folder is missing
        or cannot be written to."""
        from pftwin.results.plots import save_figure

        return list(save_figure(self.corner(), stem.with_name(f"{stem.name}_posterior")))


def corner_figure(estimate: Estimate, posterior: Posterior | None = None) -> Figure:
    """Every parameter and pair of an estimate's normal distribution, over a posterior's draws if given. Raises
    InputError for a posterior of other parameters."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from fitting.plots import fitted_to
    from pftwin.results.plots.style import COLOURS, PAGE, house_style, shortened, title

    if posterior is not None and posterior.names != estimate.names:
        found, expected = f"a posterior of {', '.join(posterior.names)}", f"of {', '.join(estimate.names)}"
        raise InputError(found, where="posterior", expected=expected)
    count = len(estimate.names)
    scales, units = zip(*(as_read(unit) for unit in estimate.units), strict=True)
    scale = np.array(scales)
    draws = None if posterior is None else scale * posterior.draws.reshape(-1, count)
    with house_style(axes__grid=False):
        side = max(PAGE, 1.0 + _SIDE * count)
        figure = Figure(figsize=(side, side))
        panels = figure.subplots(count, count, squeeze=False, sharex="col")
        for (i, j), axes in np.ndenumerate(panels):
            if j > i:
                axes.set_axis_off()
            elif i == j:
                _marginal(axes, estimate, i, float(scale[i]), None if draws is None else draws[:, i])
            else:
                _pair(axes, estimate, (j, i), scale, draws)
            _name(axes, i, j, [f"{shortened(n, 20)} [{u or '-'}]" for n, u in zip(estimate.names, units, strict=True)])
        figure.align_labels()
        what = "normal distribution about the estimate, not sampled" if posterior is None else posterior.sentence()
        title(figure, fitted_to(estimate), what)
        line, area = Line2D([], [], color=COLOURS[1]), Patch(color=COLOURS[0], alpha=0.5)
        words = "estimate: normal; 1 and 2 standard deviations"
        handles, labels = ([line], [words]) if posterior is None else ([area, line], ["posterior", words])
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def _marginal(axes: Axes, e: Estimate, i: int, scale: float, draws: Floats | None) -> None:
    from pftwin.results.plots.style import BAND, COLOURS

    if draws is not None:
        axes.hist(draws, bins=_BINS, density=True, color=COLOURS[0], alpha=0.5)
    mean, sd = scale * e.values[i], scale * e.standard_deviations[i]
    if e.names[i] in e.set_by_bounds:
        axes.axvline(mean, color=COLOURS[1])
        axes.set_yticks([])
        return
    x = np.linspace(mean - 4 * sd, mean + 4 * sd, 200)
    x = x[(x >= scale * e.lower[i]) & (x <= scale * e.upper[i])]
    density = np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
    axes.plot(x, density, color=COLOURS[1])
    if draws is None:
        axes.fill_between(x, density, color=COLOURS[1], **BAND)
    axes.set_ylim(bottom=0)
    axes.set_yticks([])


def _pair(axes: Axes, e: Estimate, pair: tuple[int, int], scale: Floats, draws: Floats | None) -> None:
    from pftwin.results.plots.style import COLOURS

    j, i = pair
    if draws is not None:
        dots = {"linestyle": "none", "marker": ".", "markersize": 1.5, "markeredgewidth": 0, "alpha": 0.5}
        axes.plot(draws[:, j], draws[:, i], color=COLOURS[0], rasterized=True, **dots)
    covariance = e.covariance * np.outer(scale, scale)
    for size in _TWICE:
        axes.plot(*_ellipse(scale * e.values, covariance, j, i, size), color=COLOURS[1])


def _name(axes: Axes, i: int, j: int, labels: list[str]) -> None:
    """Labels only the panels at the left and the bottom."""
    if i == len(labels) - 1:
        axes.set_xlabel(labels[j])
        axes.tick_params(axis="x", labelrotation=45)
    axes.locator_params(axis="x", nbins=4)
    if i > j:
        axes.locator_params(axis="y", nbins=4)
        axes.tick_params(labelleft=j == 0)
        if j == 0:
            axes.set_ylabel(labels[i])


def _ellipse(mean: Any, covariance: Any, i: int, j: int, size: float) -> tuple[Any, Any]:
    """Ellipse of two parameters' normal distribution, at so many standard deviations."""
    part = covariance[np.ix_([i, j], [i, j])]
    values, vectors = np.linalg.eigh(part)
    angle = np.linspace(0, 2 * np.pi, 100)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    x, y = size * (vectors * np.sqrt(np.maximum(values, 0))) @ circle
    return mean[i] + x, mean[j] + y
