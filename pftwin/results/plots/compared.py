"""Figures of measured against simulated quantities: an overview of a case, and a panel with RMSE for each quantity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pftwin.base.errors import InputError
from pftwin.results.metrics import Validation, validate
from pftwin.results.plots import style
from pftwin.results.plots.quantities import FEMORAL, QUANTITIES, TIBIAL, PlottedQuantity, provenance, read, tension

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result

_SHOWN = ("x", "y", "z", "flexion", "rotation", "tilt", "contact_force", "tibial_spring", "femoral_spring")
_AXES = {"time": "time [s]", "flexion": "knee flexion [deg]"}


def case_figure(results: Mapping[str, Result], measured: Measured | None, title: str) -> Figure:
    """Plots the path of the sphere's centre in two planes of the femur, and tilt and contact force over time.

    Args:
        results: results by legend name ("P2", "P4", "P5").
        measured: measurements, drawn as a wide grey line; labelled if they are synthetic.
        title: title of the figure. Synthetic motion is labelled in any case.

    Raises:
        InputError: neither results nor measurements.
    """
    from matplotlib.figure import Figure

    if not results and measured is None:
        raise InputError("nothing to draw", where="case_figure", expected="at least one result")
    with style.house_style():
        figure = Figure(figsize=(style.WIDE, 6.0))
        style.title(figure, title)
        style.footer(figure, provenance(*results.values()))
        panels = figure.subplot_mosaic([["y", "z", "tilt"], ["y", "z", "force"]], width_ratios=[1.0, 1.0, 2.2])
        across, sagittal, tilt, force = (panels[name] for name in ("y", "z", "tilt", "force"))
        if measured is not None:
            _path(across, sagittal, measured.center, label=measured.label, **style.MEASURED)
            if measured.angles is not None:
                tilt.plot(measured.times, np.degrees(measured.angles.tilt), **style.MEASURED)
            if measured.contact_force is not None:
                force.plot(measured.times, measured.contact_force, **style.MEASURED)
        for i, (name, result) in enumerate(results.items()):
            look = {**style.line(i), "zorder": 2}
            _path(across, sagittal, result.center, label=name, **look)
            tilt.plot(result.times, np.degrees(result.angles.tilt), **look)
            if result.contact is not None:
                force.plot(result.times, result.effects[result.contact]["force"], **look)
        across.set(title="Coronal path (dot: start)", xlabel="y, lateral [mm]")
        sagittal.set(title="Sagittal path", xlabel="z, anterior [mm]")
        for ax in (across, sagittal):
            ax.set(ylabel="sphere centre x, proximal [mm]")
            ax.set_aspect("equal", adjustable="datalim")
        tilt.set(title="Patellar tilt, lateral positive", xlabel="time [s]", ylabel="tilt [deg]")
        force.set(title="Normal contact force", xlabel="time [s]", ylabel="force [N]")
        style.legend_below(figure, *across.get_legend_handles_labels(), most=6)
    return figure


def _path(across: Axes, sagittal: Axes, center: np.ndarray, *, label: str, **look: Any) -> None:
    """Draws a path in both planes, proximal upwards, with a dot at the start."""
    x, y, z = 1e3 * center.T
    for axes, sideways in ((across, y), (sagittal, z)):
        axes.plot(sideways, x, label=label, **look)
        axes.plot(sideways[:1], x[:1], color=look["color"], alpha=look.get("alpha", 1.0), **style.START)


def compared(
    results: Result | Mapping[str, Result],
    measured: Measured | None,
    *,
    against: Literal["time", "flexion"] = "time",
    tibial: str | None = TIBIAL,
    femoral: str | None = FEMORAL,
    title: str | None = None,
    axes: Any = None,
) -> Figure:
    """Plots a panel for each measured quantity (wide grey line) with the simulated ones and their RMSE (`validate`).

    For skin markers, whose position is not comparable, the RMSE is computed after subtraction of the mean offset.

    Args:
        results: one result, or several by legend name.
        measured: measurements of the simulated motion; labelled if they are synthetic.
        against: horizontal axis, time or knee flexion.
        tibial: effect whose tension corresponds to the measured tibial spring force; None omits it.
        femoral: the same for the femoral spring.
        title: replaces the scenes' names. Synthetic motion is labelled in any case.
        axes: axes to draw into, one for each panel; by default a new figure, three panels wide.

    Raises:
        InputError: no result or no measurements, or as in `pftwin.validate`.
    """
    named = dict(results) if isinstance(results, Mapping) else {"simulated": results}
    if not named:
        raise InputError("nothing to draw", where="results", expected="at least one result")
    if measured is None:
        raise InputError(
            "there are no measurements to compare with",
            where="measured",
            expected="a pftwin.Measured",
            remedy="pftwin.rig.measured(2) for the rig's case 2, or load_scene_file(...).measured for a scene file's",
        )
    if against not in _AXES:
        raise InputError(f"found {against!r}", where="against", expected=f"one of: {', '.join(_AXES)}")
    errors = {name: validate(r, measured, tibial=tibial, femoral=femoral) for name, r in named.items()}
    panels = _panels(measured, list(errors.values()), tibial, femoral)
    panels += [read(next(iter(named.values())), name) for name in measured.readings]
    own = style.given_axes(axes, len(panels), f"one for each of {', '.join(q.words for q in panels)}")
    with style.house_style():
        if own is None:
            figure, own = style.panels_in_rows(len(panels), 3, height=1.85 + 0.14 * len(named))
            style.title(figure, title or style.scene_names(named.values()))
            style.footer(figure, provenance(*named.values()))
        for ax, quantity in zip(own, panels, strict=True):
            _panel(ax, quantity, named, measured, errors, against)
        if axes is None:
            style.legend_below(figure, own[0].get_lines(), [measured.label, *named], most=6)
    return style.figure_of(own[0])


def _panels(
    measured: Measured, errors: list[Validation], tibial: str | None, femoral: str | None
) -> list[PlottedQuantity]:
    """The quantities that were both measured and simulated."""
    springs = {"tibial_spring": tibial, "femoral_spring": femoral}
    found = []
    for name in _SHOWN:
        quantity, effect = QUANTITIES[name], springs.get(name)
        if effect is not None:
            quantity = tension(effect, effect.replace("_", " "), name)
        if quantity.measured(measured) is not None and any(_error(e, quantity) is not None for e in errors):
            found.append(quantity)
    return found


def _error(errors: Validation, quantity: PlottedQuantity) -> float | None:
    own = {row.key: row.value for row in errors.readings} | {m.key: m.rms_about_mean for m in errors.skin_markers}
    return own[quantity.error] if quantity.error in own else getattr(errors, quantity.error)


def _panel(
    ax: Any, quantity: PlottedQuantity, named: Mapping[str, Result], measured: Measured,
    errors: Mapping[str, Validation], against: str,
) -> None:  # fmt: skip
    first = next(iter(named.values()))
    across = first.times if against == "time" else np.degrees(np.asarray(first.knee.flexion))
    ax.plot(across, quantity.measured(measured), **style.MEASURED)
    for i, (name, result) in enumerate(named.items()):
        values, error = quantity.simulated(result), _error(errors[name], quantity)
        if values is None or error is None:
            continue
        # The figure's legend shows which line is which: names here would be wider than a panel.
        of_course = " less mean offset" if quantity.error in {m.key for m in errors[name].skin_markers} else ""
        ax.plot(across, values, label=f"RMSE {error:.3g} {quantity.unit}{of_course}", zorder=2, **style.line(i))
    ax.set(xlabel=_AXES[against], ylabel=quantity.label)
    ax.yaxis.label.set_fontsize(style.SMALL)
    style.legend_above(ax)
