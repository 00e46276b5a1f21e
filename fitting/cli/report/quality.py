"""How far the data carry: gaps and residuals of measurements, and what simulations say of themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.cli.report.html import PageSection, bullets, number, paragraph, table
from fitting.cli.report.material import Material

if TYPE_CHECKING:
    from fitting.cli.report.run import ReportedRun
    from fitting.estimate import Estimate
    from pftwin.model.measured import Measured

_CHANNELS = {
    "position of the button's centre": "center",
    "orientation of the patella": "quaternion",
    "contact force": "contact_force",
    "tibial spring force": "tibial_spring_force",
    "femoral spring force": "femoral_spring_force",
}
_READ = {"orientation": (180 / np.pi, "deg"), "position": (1e3, "mm"), **dict.fromkeys("XYZ", (1e3, "mm"))}


def section(material: Material) -> PageSection:
    """Of the measurements, of each fit, and of each run."""
    parts = []
    measured = None if material.chosen is None else material.chosen.measured
    if measured is not None:
        parts.append(_gaps(measured))
    else:
        parts.append(paragraph("No measurements of the patella are known to this report.", "missing"))
    parts += [_residuals(name, e) for name, e in material.estimates.items()]
    parts += [_run(run) for run in material.runs]
    return PageSection("quality", "Data quality", "".join(parts))


def missing(values: np.ndarray) -> tuple[int, int]:
    """Frames without a value, and the longest gap [frames]."""
    absent = np.asarray(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
    longest = run = 0
    for gone in absent:
        run = run + 1 if gone else 0
        longest = max(longest, run)
    return int(absent.sum()), longest


def _gaps(measured: Measured) -> str:
    rows = []
    for words, name in _CHANNELS.items():
        values = getattr(measured, name)
        if values is None:
            rows.append((words, "not measured", "–", "–"))
            continue
        absent, longest = missing(values)
        rows.append((words, str(len(values)), str(absent), str(longest)))
    caption = f"Measurements: {measured.source}"
    return table(caption, ("channel", "frames", "missing", "longest gap, frames"), rows)


def _residuals(name: str, e: Estimate) -> str:
    """What the fit left, by channel."""
    rows = []
    for channel in dict.fromkeys([*e.rmse, *e.noise]):
        scale, unit = _READ.get(channel, (1.0, "N"))
        cells = [number(scale * values[channel]) if channel in values else "–" for values in (e.rmse, e.noise)]
        rows.append((channel, *cells, unit))
    where = "given" if e.noise_known else "estimated from the residuals"
    facts = [
        f"Correlation of neighbouring residuals: {number(e.serial_correlation, 2)} (0: independent).",
        f"Starts: {e.starts}, of which {e.dropped} found no equilibrium or no finite motion.",
        f"Condition number of the information on the parameters: {number(e.condition, 3)}.",
    ]
    headings = ("channel", "root mean square residual", f"noise, {where}", "unit")
    return table(f"Residuals of {name}", headings, rows) + bullets(facts)


def _run(run: ReportedRun) -> str:
    """Flags, equilibrium and energy of a simulation."""
    about, frames = run.data.attrs, run.data.sizes["time"]
    facts = [f"{m.frames} of {frames} frames: {m.words}" for m in run.marks] or [f"All {frames} frames clean."]
    facts.append(f"Start: {about.get('equilibrium', 'not in the file')}")
    rows = []
    if "equilibrium_residual_N" in about:
        rows.append(("force left over at the start", number(about["equilibrium_residual_N"], 2), "N"))
    if "largest_indentation_m" in about:
        rows.append(("largest indentation", number(1e3 * float(about["largest_indentation_m"]), 3), "mm"))
    if "energy_budget_error" in run.data:
        error = np.abs(run.data["energy_budget_error"].values)
        rows.append(("largest energy that no effect accounts for", number(1e3 * np.nanmax(error), 3), "mJ"))
        rows.append(("work put in, largest", number(1e3 * np.nanmax(np.abs(run.data["work"].values)), 3), "mJ"))
    if "largest_constraint_drift_m" in about:
        rows.append(("largest constraint drift", number(1e3 * float(about["largest_constraint_drift_m"]), 2), "mm"))
    caption = f"Simulation: {run.name}"
    return (table(caption, ("check", "value", "unit"), rows) if rows else "") + bullets(facts)
