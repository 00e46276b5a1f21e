"""Sources of a prediction's uncertainty: how much narrower its bands would be if one source were known.

The draws' outcomes are regressed on the parameters of one source at a time (requested parameters, attachments,
friction): the residual is the uncertainty that would remain if they were known, with all that they imply about the
others. So shares need not sum to one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fitting.parameters import BETWEEN_TRIALS
from fitting.prediction.plots import PANELS
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


ALL = "all of them"
_FEWEST, _PER_NUMBER = 8, 4  # least number of draws, and least per parameter of a source


class BandSources(NamedTuple):
    """Share by which bands would be narrower if a source were known; NaN if there are too few draws."""

    sources: tuple[str, ...]  # kinds of parameters; the last is `ALL`
    outcomes: tuple[str, ...]  # by their names in the prediction
    narrower: Floats  # (sources, outcomes): 1 - remaining width, root mean square over variants
    title: str = ""  # of the prediction
    note: str = ""  # of the prediction

    def sheet(self) -> Sheet:
        """The shares as a table."""
        rows = (
            (name, *(f"{100 * v:.0f}" if np.isfinite(v) else "-" for v in row))
            for name, row in zip(self.sources, self.narrower, strict=True)
        )
        heads = ("if it were known", *(name.replace("_", " ") for name in self.outcomes))
        few = (f"-: at least {_PER_NUMBER} draws for each number are needed",) if np.isnan(self.narrower).any() else ()
        return Sheet("bands would be narrower by [%]", heads, tuple(rows), words=(0,), notes=few)

    def facts(self) -> dict[str, dict[str, float | None]]:
        """Shares by source and outcome, for JSON."""
        return {
            source: {name: float(v) if np.isfinite(v) else None for name, v in zip(self.outcomes, row, strict=True)}
            for source, row in zip(self.sources, self.narrower, strict=True)
        }

    def figure(self) -> Figure:
        """Bars by source, a panel for each outcome."""
        from matplotlib.figure import Figure

        from pftwin.results.plots import style

        with style.house_style():
            figure = Figure(figsize=(style.PAGE, 1.3 + 0.3 * len(self.sources)))
            panels = np.ravel(figure.subplots(1, len(self.outcomes), sharey=True))
            for ax, name, column in zip(panels, self.outcomes, self.narrower.T, strict=True):
                ax.barh(range(len(self.sources)), 100 * column, color=style.COLOURS[0])
                ax.set_title(name.replace("_", " "), fontsize=style.SMALL)
                ax.set_xlim(0, 100)
                ax.set_xlabel("bands narrower,\nif it were known [%]", fontsize=style.SMALL)
            panels[0].set_yticks(range(len(self.sources)), [style.shortened(name) for name in self.sources])
            panels[0].invert_yaxis()
            style.title(figure, f"sources of the bands of {self.title}" if self.title else "sources of the bands")
            style.footer(figure, self.note)
        return figure


def band_sources(data: Dataset, outcomes: tuple[str, ...] = tuple(name for name, _, _ in PANELS)) -> BandSources:
    """Computes the sources of a prediction's bands.

    Args:
        data: result of `fitting.predict`, with draws.
        outcomes: names in `fitting.prediction.outcomes.MEASURES`.

    Raises:
        InputError: a prediction without draws, or of an estimate without `kinds` of its parameters.
    """
    if "sample" not in data.dims or "parameter_kind" not in data.coords:
        raise InputError(
            "a prediction without draws of known sources",
            where="band_sources",
            expected="one of an estimate, with samples",
            remedy="fitting.predict(scene, treatment, estimate, samples=200)",
        )
    theta = data["parameters"].values[1:]
    of = data["parameter_kind"].values
    used = of != BETWEEN_TRIALS  # predictions are for a further trial, whose difference is in the shared parameter
    groups = {str(name): theta[:, of == name] for name in dict.fromkeys(of[used])} | {ALL: theta[:, used]}
    found = np.full((len(groups), len(outcomes)), np.nan)
    for column, name in enumerate(outcomes):
        values = data[name].transpose("variant", "sample").values[:, 1:]
        for row, numbers in enumerate(groups.values()):
            left = [_left(y[good], numbers[good]) for y in values if (good := np.isfinite(y)).any()]
            if known := [share for share in left if np.isfinite(share)]:
                found[row, column] = 1 - np.sqrt(min(1.0, np.mean(known)))
    return BandSources(tuple(groups), outcomes, found, *(data.attrs.get(key, "") for key in ("title", "note")))


def _left(y: Floats, numbers: Floats) -> float:
    """Share of the variance of y (n,) that a linear function of numbers (n, q) leaves unexplained, without bias."""
    deviations = numbers.std(axis=0)
    x = (numbers - numbers.mean(axis=0))[:, deviations > 0] / deviations[deviations > 0]
    off = y - y.mean()
    n, q = x.shape
    if n < max(_FEWEST, _PER_NUMBER * q) or not off.any():
        return np.nan
    rest = off - x @ np.linalg.lstsq(x, off, rcond=None)[0]
    return float((rest @ rest) / (n - 1 - q) / ((off @ off) / (n - 1)))
