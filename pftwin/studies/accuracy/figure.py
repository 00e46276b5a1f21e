"""Error over time spent, with the front of best settings drawn."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.results.plots.style import COLOURS, MARKERS, TINY, WIDE, house_style, legend_below
from pftwin.studies.accuracy.measure import AccuracyRow
from pftwin.studies.accuracy.table import front

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS = (("real_time", "one run"), ("real_time_batch", "64 variants side by side"))


def work_precision(rows: Sequence[AccuracyRow], title: str, *, contact: str | None = None) -> Figure:
    """Two panels: one run, and many side by side; a line for each integrator, its steps along it.

    Args:
        rows: measured; float64 alone is drawn where there is any.
        title: of the figure.
        contact: whose; by default the first of the rows.

    Raises:
        InputError: nothing to draw.
    """
    from matplotlib.figure import Figure

    if not rows:
        raise InputError("nothing to draw", where="work_precision", expected="at least one row")
    wanted = contact or rows[0].contact
    own = [r for r in rows if r.contact == wanted and np.isfinite(r.position_rms_mm) and r.position_rms_mm > 0]
    own = [r for r in own if r.dtype == "float64"] or own
    panels = [p for p in PANELS if any(np.isfinite(getattr(r, p[0])) for r in own)]
    with house_style():
        figure = Figure(figsize=(0.5 * WIDE * max(1, len(panels)), 4.6))
        axes = figure.subplots(1, max(1, len(panels)), squeeze=False, sharey=True)[0]
        for ax, (speed, name) in zip(axes, panels, strict=False):
            _panel(ax, own, speed)
            ax.set(title=name, xlabel="time spent per simulated second [ms]")
        axes[0].set_ylabel("error of the button's centre, rms [mm]")
        handles, labels = axes[0].get_legend_handles_labels()
        legend_below(figure, handles, labels, most=4 if len(panels) > 1 else 2)
        figure.suptitle(title)
    return figure


def _panel(ax: Axes, rows: Sequence[AccuracyRow], speed: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    names = list(dict.fromkeys(r.integrator for r in rows))
    for name, group in groupby(sorted(rows, key=lambda r: names.index(r.integrator)), lambda r: r.integrator):
        some = [r for r in group if np.isfinite(getattr(r, speed))]
        k = names.index(name)
        times = [1e3 / getattr(r, speed) for r in some]
        line: dict[str, Any] = {
            "color": COLOURS[k % len(COLOURS)],
            "marker": MARKERS[k % len(MARKERS)],
            "markersize": 4.5,
        }
        line["linestyle"] = "-" if k < len(COLOURS) else "--"
        ax.plot(times, [r.position_rms_mm for r in some], label=name, **line)
        for r, t in zip(some, times, strict=True):
            if not name.startswith(("diffrax", "quasi")):
                at = {"xytext": (3, 3), "textcoords": "offset points", "fontsize": TINY, "color": line["color"]}
                ax.annotate(f"{r.step_ms:g}", (t, r.position_rms_mm), **at)
    best = front(rows, speed)
    ax.plot(
        [1e3 / getattr(r, speed) for r in best],
        [r.position_rms_mm for r in best],
        color="black",
        alpha=0.18,
        linewidth=7,
        solid_capstyle="round",
        zorder=0,
        label="front of best settings (numbers: step in ms)",
    )
    ax.set(xscale="log", yscale="log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
