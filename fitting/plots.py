"""Figures of a fit: measured and fitted motion, correlations, predictions, and the search's history."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.estimate import Estimate
    from fitting.posterior.result import Posterior
    from pftwin.model.scene import Scene

DRAWS = 20  # draws from the estimate's uncertainty, each simulated
SAMPLES = 50  # draws for a prediction, simulated in one batch
_WRITTEN = 8  # most parameters for which correlations are printed as numbers


class EstimatePlots:
    """`estimate.plot`: each method returns a matplotlib figure; `figure.savefig("name.pdf")` saves it (.svg, .png)."""

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate

    def fit(self, trial: int = 1) -> Figure:
        """Measured, nominal and fitted trajectory of a trial (from 1).

        Raises:
            InputError: for an estimate read from a file, which holds neither scene nor measurements; no such trial.
        """
        import pftwin
        from pftwin.results.plots import case_figure

        e = self._estimate
        if e.trials and not 1 <= trial <= len(e.trials):
            raise InputError(f"no trial {trial}", where="trial", expected=f"1 to {len(e.trials)}")
        nominal, measured = e.trials[trial - 1] if e.trials else (None, None)
        if nominal is None or measured is None:
            raise InputError("an estimate from a file holds no measurements to draw")
        results, title = {"nominal": pftwin.simulate(nominal)}, f"{nominal.name}: {e.method}, objective {e.objective}"
        try:
            results["fitted"] = pftwin.simulate(e.scenes[trial - 1])
        except InputError:  # the estimate's verdict says why
            title += " (INVALID: no fitted motion)"
        return case_figure(results, measured, title)

    def correlation(self, axes: Any = None) -> Figure:
        """Correlations of the requested parameters' errors; values and 95 % intervals in percent of nominal values.

        Nuisance parameters are not drawn.

        Args:
            axes: two axes to draw into; by default a new figure.

        Raises:
            InputError: another number of axes.
        """
        from matplotlib.figure import Figure

        from pftwin.results.plots.style import PAGE, figure_of, given_axes, house_style, shortened, title

        own = given_axes(axes, 2, "for the correlations, and for the values")
        with house_style(axes__grid=False):
            if own is None:
                tall = 1.4 + 0.32 * max(5, self._estimate.asked)
                longest = max(len(shortened(name)) for name in self._estimate.names[: self._estimate.asked])
                wide = PAGE + 0.14 * max(0, longest - 12)  # names stand beside both panels
                figure = Figure(figsize=(wide, tall))
                own = list(figure.subplots(1, 2, width_ratios=[1.0, 1.1]))
                title(figure, fitted_to(self._estimate))
            _correlations(own[0], self._estimate)
            _values(own[1], self._estimate)
        return figure_of(own[0])

    def posterior(self, sampled: Posterior | None = None) -> Figure:
        """Every parameter and every pair: the estimate's normal distribution, over a sampled posterior if given.

        Args:
            sampled: result of `fitting.sample_posterior`; without it the estimate's distribution is drawn alone.

        Raises:
            InputError: a posterior of other parameters.
        """
        from fitting.posterior.plots import corner_figure

        return corner_figure(self._estimate, sampled)

    def response(
        self, variants: Any, scene: Scene | None = None, *, samples: int = SAMPLES, title: str | None = None,
        axes: Any = None,
    ) -> Figure:  # fmt: skip
        """Outcomes against the amount of a treatment, with 95 % bands from the estimate's uncertainty.

        Args:
            variants: a grid of treatments (`fitting.prediction.variants.grid`), as `fitting.predict` takes it.
            scene: untreated scene; by default the one that was fitted.
            samples: draws from the estimate's uncertainty; 0 gives lines without bands.
            title, axes: as in `fitting.prediction.plots.outcome_figure`, which draws an existing prediction.

        Raises:
            InputError: an estimate from a file without `scene`; no amount varies; what `fitting.predict` refuses.
        """
        from fitting.prediction.plots import outcome_figure
        from fitting.prediction.predicting import predict

        data = predict(self._scene(scene), variants, self._estimate, samples=samples)
        return outcome_figure(data, title, axes=axes)

    def against_flexion(self, scene: Scene | None = None, *, draws: int = DRAWS, seed: int = 0, **more: Any) -> Figure:
        """Tracking and contact force against knee flexion: mean and SD over draws from the estimate's uncertainty.

        Args:
            scene: by default the one that was fitted; parameters that differ between trials are those of a further one.
            draws: simulations in addition to the estimate's own.
            seed: of the draws.
            more: options of `pftwin.results.plots.against_flexion`.

        Raises:
            InputError: an estimate from a file without `scene`; fewer than one draw; a knee that does not bend.
        """
        import pftwin
        from pftwin.results.plots import against_flexion

        if draws < 1:
            raise InputError(f"found {draws!r}", where="draws", expected="a whole number, at least 1")
        e, nominal = self._estimate, self._scene(scene)
        thetas = [e.values, *e.samples(draws, seed)]
        results = [pftwin.simulate(e.apply(nominal, theta)) for theta in thetas]
        about = {"title": f"{fitted_to(e)}: the estimate and {draws} draws from its uncertainty", **more}
        return against_flexion({"fitted": results}, **about)

    def history(self, ax: Axes | None = None) -> Figure:
        """The best objective so far against the evaluations."""
        from matplotlib.figure import Figure

        from pftwin.results.plots.style import COLOURS, figure_of, house_style

        e = self._estimate
        with house_style():
            own = Figure(figsize=(5.0, 3.0)).subplots() if ax is None else ax
            known = [h for h in e.history if np.isfinite(h["best"])]
            own.plot([h["evaluations"] for h in known], [h["best"] for h in known], color=COLOURS[0], marker=".")
            own.set(xlabel="evaluations", ylabel=f"objective [{e.objective_unit}]", title=f"{e.method}: best so far")
        return figure_of(own)

    def save(self, stem: Path) -> list[Path]:
        """Saves all figures as PNG and SVG: STEM_fit, STEM_correlation, STEM_history; STEM_fit_2 of trial 2.

        Raises:
            OutputError: if the folder is missing or cannot be written to.
        """
        from pftwin.results.plots import save_figure

        drawn: dict[str, Any] = {"fit": self.fit, "correlation": self.correlation, "history": self.history}
        drawn |= {f"fit_{n}": partial(self.fit, n) for n in range(2, len(self._estimate.trials) + 1)}
        return [p for name, draw in drawn.items() for p in save_figure(draw(), stem.with_name(f"{stem.name}_{name}"))]

    def _scene(self, scene: Scene | None) -> Scene:
        found = self._estimate.nominal_scene if scene is None else scene
        if found is None:
            raise InputError("an estimate from a file holds no scene", where="scene", remedy="name it: scene=...")
        return found


def fitted_to(e: Estimate) -> str:
    """What was fitted to which measurements; synthetic ones are labelled."""
    what = "synthetic measurements" if e.synthetic else e.source
    return f"{e.scene_name}, fitted to {what} ({', '.join(e.channels)})"


def _correlations(ax: Axes, e: Estimate) -> None:
    from pftwin.results.plots.style import shortened

    p, correlation = e.asked, e.correlation[: e.asked, : e.asked]
    names = [shortened(name) for name in e.names[:p]]
    picture = ax.imshow(correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    ax.set_xticks(range(p), names, rotation=90 if p > 6 else 0)
    ax.set_yticks(range(p), names)
    for i in range(p if p <= _WRITTEN else 0):
        for j in range(p):
            colour = "white" if abs(correlation[i, j]) > 0.6 else "black"
            words = f"{correlation[i, j]:.2f}".replace("-", "\N{MINUS SIGN}")
            ax.text(j, i, words, ha="center", va="center", color=colour)
    ax.figure.colorbar(picture, ax=ax, shrink=0.8, ticks=[-1, -0.5, 0, 0.5, 1])
    ax.set_title("Correlation of the parameters' errors")


def _values(ax: Axes, e: Estimate) -> None:
    """Values in percent of the nominal ones, since units differ; in units of 1 where the nominal value is zero."""
    from pftwin.results.plots.style import COLOURS, TINY, shortened

    rows, nominal, values = np.arange(e.asked), e.nominal[: e.asked], e.values[: e.asked]
    scale = np.where(nominal == 0, 1.0, np.abs(nominal))
    off = 100 * (values - nominal) / scale
    errors = 100 * (e.intervals[: e.asked] - values[:, None]) / scale[:, None]
    errors[[name in e.set_by_bounds for name in e.names[: e.asked]]] = np.nan
    ax.errorbar(off, rows, xerr=np.abs(errors).T, fmt="o", markersize=5, color=COLOURS[0], capsize=3)
    for row, mark in enumerate(map(e.bound_mark, e.names[: e.asked])):
        look = {"textcoords": "offset points", "ha": "center", "va": "bottom", "fontsize": TINY}
        ax.annotate(mark, (off[row], row), xytext=(0, 5), **look)
    ax.axvline(0, color="black", linewidth=0.8)
    ax.set_yticks(rows, [shortened(name) for name in e.names[: e.asked]])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set(xlabel="deviation from the nominal value [%]", title="Estimate with 95 % intervals")
