"""A case at a glance: the path of the button in two planes, tilt and contact force over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.results.plots.style import MEASURED, START, WIDE, house_style, legend_below, line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.results.result import Result


def case_figure(results: Mapping[str, Result], measured: Measured | None, title: str) -> Figure:
    """Trajectory of the sphere's centre in two planes of the femur, tilt and contact force over time.

    Args:
        results: by the name in the legend ("P2", "P4", "P5").
        measured: drawn as a wide grey line; labelled synthetic where it is.
        title: of the figure.

    Raises:
        InputError: neither results nor measurements.
    """
    from matplotlib.figure import Figure

    if not results and measured is None:
        raise InputError("nothing to draw", where="case_figure", expected="at least one result")
    with house_style():
        figure = Figure(figsize=(WIDE, 6.0))
        panels = figure.subplot_mosaic([["y", "z", "tilt"], ["y", "z", "force"]], width_ratios=[1.0, 1.0, 2.2])
        across, sagittal, tilt, force = (panels[name] for name in ("y", "z", "tilt", "force"))
        if measured is not None:
            _path(across, sagittal, measured.center, label=measured.label, **MEASURED)
            if measured.angles is not None:
                tilt.plot(measured.times, np.degrees(measured.angles.tilt), **MEASURED)
            if measured.contact_force is not None:
                force.plot(measured.times, measured.contact_force, **MEASURED)
        for i, (name, result) in enumerate(results.items()):
            look = {**line(i), "zorder": 2}
            _path(across, sagittal, result.center, label=name, **look)
            tilt.plot(result.times, np.degrees(result.angles.tilt), **look)
            if result.contact is not None:
                force.plot(result.times, result.effects[result.contact]["force"], **look)
        _name_axes(across, sagittal, tilt, force)
        handles, labels = across.get_legend_handles_labels()
        legend_below(figure, handles, labels, most=6)
        figure.suptitle(title)
    return figure


def _path(across: Axes, sagittal: Axes, center: np.ndarray, *, label: str, **look: Any) -> None:
    """Proximal upwards in both planes; the start is marked."""
    x, y, z = 1e3 * center.T
    for axes, sideways in ((across, y), (sagittal, z)):
        axes.plot(sideways, x, label=label, **look)
        axes.plot(sideways[:1], x[:1], color=look["color"], alpha=look.get("alpha", 1.0), **START)


def _name_axes(across: Axes, sagittal: Axes, tilt: Axes, force: Axes) -> None:
    across.set(title="Coronal path (dot: start)", xlabel="y, lateral [mm]", ylabel="sphere centre x, proximal [mm]")
    sagittal.set(title="Sagittal path", xlabel="z, anterior [mm]", ylabel="sphere centre x, proximal [mm]")
    tilt.set(title="Patellar tilt, lateral positive", xlabel="time [s]", ylabel="tilt [deg]")
    force.set(title="Normal contact force", xlabel="time [s]", ylabel="force [N]")
    for axes in (across, sagittal):
        axes.set_aspect("equal", adjustable="datalim")
