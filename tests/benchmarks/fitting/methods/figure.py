"""The comparison as a figure: best so far against evaluations and against processor time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from tests.benchmarks.fitting.methods.entrants import ENTRANTS
from tests.benchmarks.fitting.methods.meter import Best, Course
from tests.benchmarks.fitting.methods.table import OURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FLOOR = 1e-4  # what is drawn of less [mm]
_POINTS = 200


def comparison_figure(courses: Mapping[str, Sequence[Course]], budget: tuple[float, float]) -> Figure:
    """Median over seeds and the middle half of them; ours above, others' below with our default in black.

    Args:
        courses: by method.
        budget: evaluations and seconds at which the table compares: dotted lines.

    Raises:
        InputError: no run found anything.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    from pftwin.results.plots.style import SMALL, house_style, line

    values = [b.value for runs in courses.values() for r in runs for b in r.bests]
    if not values:
        raise InputError("no run found anything", where="comparison_figure", expected="at least one")
    with house_style():
        figure = Figure(figsize=(10.0, 7.5))
        panels = figure.subplots(2, 2, sharex="col", sharey=True)
        for row, own in zip(panels, (True, False), strict=True):
            shown = [e for e in ENTRANTS if e.own == own and e.name in courses]
            for axes, count, mark, name in zip(row, _COUNTS, budget, _NAMES, strict=True):
                if not own and OURS in courses:
                    _curve(axes, courses[OURS], count, min(values), "least squares (default)", color="black", lw=1.0)
                for i, entrant in enumerate(shown):
                    _curve(axes, courses[entrant.name], count, min(values), entrant.label, **line(i))
                axes.axvline(mark, color="black", linestyle=":", linewidth=0.8)
                axes.set(xscale="log", yscale="log", xlabel=name)
                axes.xaxis.set_major_formatter("{x:g}")
                axes.yaxis.set_major_formatter("{x:g}")
                axes.xaxis.set_minor_formatter(NullFormatter())
            row[0].set(ylabel="objective above the best seen [mm]", title="Ours" if own else "Others'")
            row[1].legend(loc="lower left", fontsize=SMALL)  # curves fall
        seeds = max(len(runs) for runs in courses.values())
        figure.suptitle(
            "Paper's objective on case 2, SYNTHETIC measurements: best so far.\n"
            f"Line: median of {seeds} seeds; band: middle half of them; dotted: where the table compares",
        )
    return figure


_NAMES = ("evaluations (a point with derivatives counts 1 + p)", "processor time [s]")
_COUNTS: tuple[Callable[[Best], float], ...] = (lambda b: b.evaluations, lambda b: b.cpu)


def _curve(
    axes: Axes, courses: Sequence[Course], count: Callable[[Best], float], best: float, label: str, **line: Any
) -> None:
    grid, excess = best_so_far(courses, count, best)
    if grid.size:
        low, middle, high = np.quantile(excess, (0.25, 0.5, 0.75), axis=0)
        axes.fill_between(grid, low, high, color=line["color"], alpha=0.12, linewidth=0)
        axes.plot(grid, middle, label=label, **line)


def best_so_far(courses: Sequence[Course], count: Callable[[Best], float], best: float) -> tuple[Floats, Floats]:
    """A common grid (k,) of evaluations or seconds, and every run's objective above the best there (seeds, k) [mm].

    The grid begins where all runs have found something; a run that has ended keeps what it found.
    """
    if not courses or not all(c.bests for c in courses):
        return np.zeros(0), np.zeros((len(courses), 0))
    first = max(count(c.bests[0]) for c in courses)
    last = max(first * 1.001, *(count(c.bests[-1]) for c in courses))
    grid = np.geomspace(first, last, _POINTS)
    grid[0], grid[-1] = first, last
    rows = []
    for course in courses:
        at = np.array([count(b) for b in course.bests])
        values = np.array([b.value for b in course.bests])
        rows.append(values[np.searchsorted(at, grid, side="right") - 1])
    return grid, np.maximum(1e3 * (np.array(rows) - best), FLOOR)
