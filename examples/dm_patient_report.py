"""Tables and figures of examples/dm_patient.py."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from dm_knee import LIGAMENTS
from dm_patient_fit import FITS, FREE, HEIGHT, TENDONS, Outcome, Patient
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from pftwin.dynamics.status import Status
from pftwin.results.plots import COLOURS, STYLE, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fitting.identifiability import ExperimentPlan

Floats = NDArray[np.float64]
Bands = dict[str, tuple[Floats, Floats]]

TITLES = {"quadriceps": "quadriceps", "patellar_tendon": "patellar tendon"}
NOTE = "recording simulated by OpenSim JAM"
_RECORDED = {"color": "black", "linewidth": 2.6, "alpha": 0.35, "zorder": 1}
_DASHES = ("-", "--", ":", "-.")
console = Console(soft_wrap=True)


def _letter(name: str) -> str:
    """Letter of a fit in the tables."""
    return "ABCDEFGH"[list(FITS).index(name)]


def print_patient(case: Patient) -> None:
    """Prints the attachments, widths and lengths of the two tendons."""
    table = Table(title="Two effective tendons from 60 strands and four muscles (mm, in each body's frame)")
    for heading in ("tendon", "origin", "insertion", "half widths", "length over the motion"):
        table.add_column(heading)
    for name in TENDONS:
        c = case.courses[name]
        points = [" ".join(f"{1e3 * v:6.1f}" for v in p) for p in (c.origin, c.insertion)]
        widths = f"{1e3 * c.origin_half_width:.1f}, {1e3 * c.insertion_half_width:.1f}"
        table.add_row(TITLES[name], *points, widths, f"{1e3 * c.length.min():.1f} to {1e3 * c.length.max():.1f}")
    console.print(table)
    console.print("The recording is itself a simulation, by OpenSim JAM. Fits see its tensions only where they say so.")


def print_fit(name: str, found: Outcome) -> None:
    """Prints the summary of one fit, with its uncertainty and remarks."""
    e = found.estimate
    off = int(np.sum((found.result.flags & int(Status.LEFT_PATCH)) != 0))
    console.print(
        f"\n[bold]{_letter(name)}: fitted to {name}[/bold] ({e.starts} starts, {e.evaluations} evaluations; {e.reason})"
    )
    console.print(e.sentence())
    for remark in e.remarks():
        console.print(f"  {remark}")
    if off:
        console.print(f"  a loaded contact lies beyond the fitted patch in {off} of {found.result.times.size} frames")


def print_comparison(case: Patient, found: dict[str, Outcome]) -> None:
    """Prints tables that compare all fits."""
    console.print()
    console.print(_tracking(found))
    console.print(_parameters(case, found))
    console.print(_tensions(found))
    last = {kind: f"{kind} {case.knee.tensions.column(column)[-1]:.0f} N" for kind, column in LIGAMENTS.items()}
    console.print(f"Recorded at the last frame: {last['PT']}; left out of the scene: {last['MPFL']}, {last['LPFL']}.")


def print_ideal(plan: ExperimentPlan) -> None:
    """Prints what the same motion would determine if the model were correct."""
    console.print("\n[bold]Were the model right[/bold], and positions good to 0.2 mm with independent errors:")
    console.print(plan.sentence())


def _tracking(found: dict[str, Outcome]) -> Table:
    table = Table(title=f"Poses against recorded ones ({NOTE})")
    headings = ("fitted to", "mean distance (mm)", "rms proximal / lateral / anterior (mm)")
    for heading in (*headings, "angles x / y / z, rms (deg)"):
        table.add_column(heading)
    for name, o in found.items():
        rms, turns = np.sqrt((o.offset**2).mean(axis=0)), np.sqrt((o.angles**2).mean(axis=0))
        table.add_row(
            f"{_letter(name)}: {name}",
            f"{1e3 * o.mean_distance:.2f}",
            " / ".join(f"{1e3 * v:.2f}" for v in rms),
            " / ".join(f"{v:.2f}" for v in turns),
        )
    return table


def _parameters(case: Patient, found: dict[str, Outcome]) -> Table:
    table = Table(title="Parameters with 95 % intervals; last row: as recorded tensions and directions have them")
    table.add_column("fit", no_wrap=True)
    for name, unit in zip((*FREE, "origin z"), (*("kN/m", "mm") * 2, "mm"), strict=True):
        table.add_column(f"{name} ({unit})")
    for label, o in found.items():
        e = o.estimate
        cells = []
        for name, value, (low, high) in zip(e.names, e.values, e.intervals, strict=True):
            s = 1e-3 if name.startswith("K") else 1e3
            marked = " (at its bound)" if name in e.at_bounds else ""
            cells.append(f"{s * value:.4g} ({s * low:.3g} to {s * high:.3g}){marked}")
        table.add_row(_letter(label), *cells)
    known = {**case.reference, HEIGHT: case.courses["quadriceps"].origin[2]}
    last = (f"{(1e-3 if n.startswith('K') else 1e3) * value:.4g}" for n, value in known.items())
    table.add_row("recorded", *last)
    return table


def _tensions(found: dict[str, Outcome]) -> Table:
    table = Table(title="Tensions against recorded ones; last column: quadriceps / patellar tendon, over recorded")
    for heading in ("fit", "tendon", "correlation", "rms (N)", "over recorded", "last frame (N)", "ratio"):
        table.add_column(heading)
    for label, o in found.items():
        seen = {name: o.agreement(name) for name in TENDONS}
        ratio = seen[TENDONS[0]].ratio / seen[TENDONS[1]].ratio
        for name, a in seen.items():
            fitted = " (fitted)" if name in o.estimate.channels else ""
            numbers = (f"{a.correlation:.3f}", f"{a.rms:.1f}", f"{a.ratio:.2f}")
            last = f"{o.tension(name)[-1]:.0f} of {o.recorded[name][-1]:.0f}"
            table.add_row(_letter(label), TITLES[name] + fitted, *numbers, last, f"{ratio:.2f}")
    return table


def save_figures(case: Patient, found: dict[str, Outcome], bands: dict[str, Bands], out: Path) -> None:
    """Writes the figures dm_patient_poses and dm_patient_tensions as PNG and SVG."""
    save_figure(_poses_figure(case, found), out / "dm_patient_poses")
    save_figure(_tensions_figure(case, found, bands), out / "dm_patient_tensions")


def _poses_figure(case: Patient, found: dict[str, Outcome]) -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    outcomes = list(found.values())
    knee = np.degrees(outcomes[0].result.knee.flexion)
    recorded = case.measured.angles
    assert recorded is not None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 6.0))
        panels = figure.subplots(2, 3, sharex=True)
        for i, side in enumerate(("proximal", "lateral", "anterior")):
            panels[0, i].plot(knee, 1e3 * case.measured.center[:, i], label="recorded", **_RECORDED)
            panels[0, i].set(title=f"Sphere centre, {side}", ylabel="position in the femur [mm]" if i == 0 else "")
        for i, angle in enumerate(("flexion", "rotation", "tilt")):
            panels[1, i].plot(knee, np.degrees(getattr(recorded, angle)), **_RECORDED)
            panels[1, i].set(
                title=f"Patellar {angle}", xlabel="knee flexion [deg]", ylabel="angle [deg]" if i == 0 else ""
            )
        for k, (name, o) in enumerate(found.items()):
            line = {"color": COLOURS[k], "linestyle": _DASHES[k]}
            for i, angle in enumerate(("flexion", "rotation", "tilt")):
                panels[0, i].plot(knee, 1e3 * o.result.center[:, i], label=f"{_letter(name)}: {name}", **line)
                panels[1, i].plot(knee, np.degrees(getattr(o.result.angles, angle)), **line)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(found) + 1)
        figure.suptitle(f"DM patient: two effective tendons fitted to poses ({NOTE})")
    return figure


def _tensions_figure(case: Patient, found: dict[str, Outcome], bands: dict[str, Bands]) -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    knee = np.degrees(next(iter(found.values())).result.knee.flexion)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 6.0))
        panels = figure.subplots(len(TENDONS), len(found), sharex=True, sharey="row")
        for j, (label, band) in enumerate(bands.items()):
            for i, name in enumerate(TENDONS):
                recorded = case.knee.tensions.column(name)
                _tension_panel(panels[i, j], knee, recorded, band[name], COLOURS[j])
                if i == 0:
                    panels[i, j].set_title(f"{_letter(label)}: {label}")
                if j == 0:
                    panels[i, j].set_ylabel(f"{TITLES[name]}: tension [N]")
                if i == len(TENDONS) - 1:
                    panels[i, j].set_xlabel("knee flexion [deg]")
        panels[0, 0].legend(loc="upper left")
        figure.suptitle(f"DM patient: tensions of the fitted tendons with 95 % bands ({NOTE})")
    return figure


def _tension_panel(axes: Axes, knee: Floats, recorded: Floats, band: tuple[Floats, Floats], colour: str) -> None:
    value, half = band
    axes.plot(knee, recorded, label="recorded", **_RECORDED)
    axes.plot(knee, value, color=colour, label="fitted")
    axes.fill_between(knee, np.maximum(value - half, 0), value + half, color=colour, alpha=0.2, linewidth=0)
    top = 2.2 * recorded.max()
    axes.set_ylim(0, top)
    if value.max() > top:
        axes.annotate(f"up to {value.max():.0f} N", (0.97, 0.05), xycoords="axes fraction", ha="right", color=colour)
