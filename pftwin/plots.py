"""Figures in one house style, safe for colour-blind readers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.errors import InputError
from pftwin.measured import Measured
from pftwin.output import written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.result import Result

# Okabe and Ito 2008, without the yellow, which is faint on white; measurements are black.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
_DASHES = ("-", (0, (6, 1.5)), (0, (3, 1.2)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)))
STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "pftwin",
}
_MEASURED: dict[str, Any] = {"color": "black", "linewidth": 2.6, "alpha": 0.35, "zorder": 1}


def case_figure(results: Mapping[str, Result], measured: Measured | None, title: str) -> Figure:
    """Trajectory of the sphere's centre in two planes of the femur, tilt and contact force over time.

    Args:
        results: by the name in the legend ("P2", "P4", "P5").
        measured: drawn as a wide grey line; labelled synthetic where it is.
        title: of the figure.

    Raises:
        InputError: neither results nor measurements.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    if not results and measured is None:
        raise InputError("nothing to draw", where="case_figure", expected="at least one result")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 6.0))
        panels = figure.subplot_mosaic([["y", "z", "tilt"], ["y", "z", "force"]], width_ratios=[1.0, 1.0, 2.2])
        across, sagittal, tilt, force = (panels[name] for name in ("y", "z", "tilt", "force"))
        if measured is not None:
            _path(across, sagittal, measured.center, label=measured.label, **_MEASURED)
            if measured.angles is not None:
                tilt.plot(measured.times, np.degrees(measured.angles.tilt), **_MEASURED)
            if measured.contact_force is not None:
                force.plot(measured.times, measured.contact_force, **_MEASURED)
        for i, (name, result) in enumerate(results.items()):
            line = {"color": COLOURS[i % len(COLOURS)], "linestyle": _DASHES[i % len(_DASHES)], "zorder": 2}
            _path(across, sagittal, result.center, label=name, **line)
            tilt.plot(result.times, np.degrees(result.angles.tilt), **line)
            if result.contact is not None:
                force.plot(result.times, result.effects[result.contact]["force"], **line)
        _name_axes(across, sagittal, tilt, force)
        handles, labels = across.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        figure.suptitle(title)
    return figure


def _path(across: Axes, sagittal: Axes, center: np.ndarray, *, label: str, **line: Any) -> None:
    """Proximal upwards in both planes; the start is marked."""
    x, y, z = 1e3 * center.T
    for axes, sideways in ((across, y), (sagittal, z)):
        axes.plot(sideways, x, label=label, **line)
        axes.plot(sideways[:1], x[:1], marker="o", markersize=4, color=line["color"], alpha=line.get("alpha", 1.0))


def _name_axes(across: Axes, sagittal: Axes, tilt: Axes, force: Axes) -> None:
    across.set(title="Coronal path (dot: start)", xlabel="y, lateral [mm]", ylabel="sphere centre x, proximal [mm]")
    sagittal.set(title="Sagittal path", xlabel="z, anterior [mm]", ylabel="sphere centre x, proximal [mm]")
    tilt.set(title="Patellar tilt, lateral positive", xlabel="time [s]", ylabel="tilt [deg]")
    force.set(title="Normal contact force", xlabel="time [s]", ylabel="force [N]")
    for axes in (across, sagittal):
        axes.set_aspect("equal", adjustable="datalim")


def save_figure(figure: Figure, stem: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Writes STEM.png and STEM.svg, each whole or not at all.

    Raises:
        OutputError: the folder is missing or cannot be written to.
    """
    import matplotlib as mpl

    base = Path(stem)
    png, svg = (base.with_name(base.name + suffix) for suffix in (".png", ".svg"))
    with mpl.rc_context(STYLE):
        with written_whole(png) as temporary:
            figure.savefig(temporary, dpi=160)
        with written_whole(svg) as temporary:
            figure.savefig(temporary, metadata={"Date": None})
    return png, svg
