"""An audit as bars: how far each effect moves the patella, what it does to forces, and the time it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pftwin.results.plots.style import COLOURS, SMALL, WIDE, house_style
from pftwin.studies.audit.audit import Audit, Worth
from pftwin.studies.audit.report import columns
from pftwin.studies.tables import Column

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOUR = {"left out": COLOURS[0], "put in": COLOURS[1], "changed": COLOURS[2], "yardstick": "0.55"}
_MOST = 150.0  # [%]: times beyond are written out
_LEAST = 1e-3  # [mm], [N]: changes below are drawn as if they were none


def audit_figure(found: Audit, title: str) -> Figure:
    """Bars for every variant: largest and rms distance from the scene's path, contact force and tension, time."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    data = {c.key: c for c in columns(found)}
    rows = found.rows
    with house_style():
        figure = Figure(figsize=(WIDE, 1.6 + 0.34 * len(rows)))
        path, force, time = figure.subplots(1, 3, sharey=True, width_ratios=[1.5, 1.2, 1.0])
        _bars(path, rows, data["path_rms_mm"], data["path_max_mm"])
        path.axvline(1e3 * found.tolerance, color="black", linestyle=(0, (4, 2)), linewidth=1.0)
        path.annotate(
            f"tolerance {1e3 * found.tolerance:g} mm", (1e3 * found.tolerance, -0.75), xytext=(3, 0),
            textcoords="offset points", fontsize=SMALL, va="center", annotation_clip=False,
        )  # fmt: skip
        _bars(force, rows, data["contact_rms_N"], data["contact_max_N"])
        _time(time, rows, data["time_percent"], data["time_spread_percent"])
        path.set_yticks(range(len(rows)), [row.name for row in rows])
        path.set_ylim(len(rows) - 0.4, -1.1)
        path.set(title="Path: bar rms, line to the largest", xlabel="distance from the scene's own path [mm]")
        force.set(title="Contact force: bar rms, line to the largest", xlabel="change [N]")
        time.set(title="Time that it takes", xlabel="share of the scene's run [%]")
        shown = [k for k in _COLOUR if any(r.kind == k for r in rows)]
        patches = [Patch(color=_COLOUR[k], label=k) for k in shown]
        figure.legend(handles=patches, loc="outside lower center", ncols=len(patches))
        figure.suptitle(title)
    return figure


def _bars(axes: Axes, rows: tuple[Worth, ...], rms: Column, largest: Column) -> None:
    """On a logarithmic axis, which starts where changes stop to matter."""
    ends = np.array(largest.values)
    high = max(10 * _LEAST, np.nanmax(ends, initial=_LEAST))
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, 2 * high)
    for i, row in enumerate(rows):
        if row.changes is None:
            axes.annotate(
                row.outcome, (_LEAST, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=SMALL,
                color=_COLOUR[row.kind],
            )  # fmt: skip
            continue
        if np.isnan(rms.values[i]):
            axes.annotate("none", (_LEAST, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=SMALL)
            continue
        axes.barh(i, max(rms.values[i], _LEAST), height=0.6, left=0, color=_COLOUR[row.kind])
        axes.plot([max(rms.values[i], _LEAST), max(ends[i], _LEAST)], [i, i], color=_COLOUR[row.kind], linewidth=1.6)
        if ends[i] < _LEAST:
            note = f"below {_LEAST:g}"
            axes.annotate(note, (_LEAST, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=SMALL)
    axes.grid(False, axis="y")
    axes.set_axisbelow(True)


def _time(axes: Axes, rows: tuple[Worth, ...], share: Column, spread: Column) -> None:
    """Shares beyond the axis are written out."""
    inside = [v for v in share.values if abs(v) <= _MOST]
    low, high = min(-10.0, *inside), max(10.0, *inside)
    margin = 0.15 * (high - low)
    axes.set_xlim(low - margin, high + margin)
    axes.axvline(0, color="black", linewidth=0.8)
    for i, row in enumerate(rows):
        value = share.values[i]
        if np.isnan(value):
            axes.annotate(
                "ran beside others", (0, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=SMALL
            )
            continue
        drawn = float(np.clip(value, *axes.get_xlim()))
        axes.barh(i, drawn, height=0.6, color=_COLOUR[row.kind], alpha=1.0 if drawn == value else 0.35)
        if drawn == value:
            axes.errorbar(value, i, xerr=spread.values[i], color="black", linewidth=0.8, capsize=2)
        else:
            # On the other side of the axis, where there is room.
            side = {"ha": "left", "xytext": (4, 0)} if value < 0 else {"ha": "right", "xytext": (-4, 0)}
            axes.annotate(f"{value:+,.0f} %", (0, i), textcoords="offset points", va="center", fontsize=SMALL, **side)
    axes.grid(False, axis="y")
    axes.set_axisbelow(True)
