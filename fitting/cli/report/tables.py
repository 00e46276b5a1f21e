"""Tables of a report, in display units."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.pages import number
from pftwin.base.errors import InputError
from pftwin.base.quantities import as_read, declarations
from pftwin.base.sheet import Sheet
from pftwin.base.text_files import csv_cells, read_lines

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.cli.report.run import ReportedRun
    from fitting.estimate import Estimate
    from pftwin.model.effects.base import Effect
    from pftwin.model.measured import Measured
    from pftwin.model.scene import Scene

# For each SI unit: the factor to the display unit, and that unit.
_PARAMETERS = {"m": (1e3, "mm"), "kg": (1e3, "g"), "m/s": (1e3, "mm/s"), "Pa": (1e-6, "MPa"), "m/s^2": (1.0, "m/s²")}
_FORCES = {"m": (1e3, "mm"), "1": (1.0, "")}
_RESIDUALS = {"orientation": (180 / np.pi, "deg"), "position": (1e3, "mm"), **dict.fromkeys("XYZ", (1e3, "mm"))}
_CHANNELS = {
    "position of the button's centre": "center",
    "orientation of the patella": "quaternion",
    "contact force": "contact_force",
    "tibial spring force": "tibial_spring_force",
    "femoral spring force": "femoral_spring_force",
}
_CHECKS = (  # label, attribute of the file, factor, digits, unit
    ("residual force at the start", "equilibrium_residual_N", 1.0, 2, "N"),
    ("largest indentation", "largest_indentation_m", 1e3, 3, "mm"),
    ("largest constraint drift", "largest_constraint_drift_m", 1e3, 2, "mm"),
)
_ENERGIES = {
    "numerical_dissipation": "largest energy lost or gained by time stepping",
    "energy_budget_error": "largest error of the energy balance",
    "work": "largest work of guided bodies and known forces",
}
SIMULATED = {
    "integrator": "integrator",
    "dt_s": "longest time step [s]",
    "substeps": "steps between frames",
    "tolerance_m": "tolerance [m]",
    "error_estimate_m": "estimated error [m]",
    "dtype": "number format",
    "pftwin_version": "pftwin",
    "jax_version": "JAX",
}
_MOST_NAMES = 6  # most parameters named in a sentence
PREDICTED = {"source": "made by", "jax_version": "JAX", "dt": "longest time step [s]", "seed": "seed of the draws"}


def parameters(scene: Scene) -> Sheet:
    """All parameters that the effects of a scene declare, and the mass of the patella."""
    rows = [("patella", "mass", number(1e3 * float(scene.patella.mass)), "g")]
    rows += [(_words(effect.name), *row) for effect in scene.effects for row in _declared(effect)]
    return Sheet("Parameters of the scene", ("effect", "quantity", "value", "unit"), tuple(rows))


def _declared(effect: Effect) -> Iterator[tuple[str, str, str]]:
    """Yields quantity, value and unit of every parameter of an effect; for a surface, only its type."""
    from pftwin.geometry.patch.fit import name_of

    surface = None
    if (contact := effect.contact_role()) is not None:
        surface, fitted = contact.groove_surface(), contact.fitted_surface()
        yield ("surface of the trochlea", "mesh" if fitted is None else f"fitted patch {name_of(fitted) or ''}", "")
    line = effect.line_element()
    points: dict[tuple[str, ...], list[Any]] = {}
    for path, leaf, declared in declarations(effect):
        if declared is None or (surface is not None and getattr(effect, path[0]) is surface):
            continue
        scale, unit = _PARAMETERS.get(declared.unit, (1.0, declared.unit))
        if not declared.frame:
            yield (declared.words or _words(", ".join(path)), _value(leaf, scale), unit)
            continue
        point = points.setdefault(path[:-1], [])
        point.append(leaf)
        if len(point) == 3:
            frame = line.line_ends[1] if declared.frame == "body" and line is not None else declared.frame
            words = f"{declared.words or _words(', '.join(path[:-1]))} ({frame}; x, y, z)"
            yield (words, ", ".join(_value(c, scale) for c in point), unit)


def _value(leaf: Any, scale: float) -> str:
    """Formats one number, or the range of several."""
    values = scale * np.asarray(leaf, dtype=np.float64).ravel()
    if values.size == 1 or np.ptp(values) == 0:
        return number(values[0])
    return f"{number(values.min())} to {number(values.max())}"


def forces(run: ReportedRun) -> Sheet:
    """Smallest, mean and largest values of a run's forces, angles and offset from the groove."""
    rows = []
    for name, variable in run.data.data_vars.items():
        unit = str(variable.attrs.get("units", ""))
        shown = unit == "N" and not str(name).endswith(("_x", "_y", "_z"))
        shown = shown or str(name) in ("knee_flexion", "patella_flexion", "patella_tilt", "groove_offset")
        if not shown or "time" not in variable.dims:
            continue
        values = np.asarray(variable.values, dtype=np.float64)
        values = values[np.isfinite(values)]
        scale, unit = _FORCES.get(unit, (1.0, unit))
        three = [number(scale * v) for v in (values.min(), values.mean(), values.max())] if values.size else ["–"] * 3
        rows.append((str(variable.attrs.get("long_name", name)), *three, unit))
    headings = ("quantity", "smallest", "mean", "largest", "unit")
    return Sheet(f"Over the motion: {run.name}", headings, tuple(rows))


def measurements(measured: Measured) -> Sheet:
    """Number of frames, of frames without a value, and the longest gap, for every channel."""
    rows = []
    given = {**{words: getattr(measured, name) for words, name in _CHANNELS.items()}, **measured.readings}
    for words, values in given.items():
        if values is None:
            rows.append((words, "not measured", "–", "–"))
            continue
        absent = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        gaps = "".join("x" if missing else " " for missing in absent).split()
        rows.append((words, str(len(values)), str(int(absent.sum())), str(max(map(len, gaps), default=0))))
    headings = ("channel", "frames", "missing", "longest gap, frames")
    return Sheet(f"Measurements: {measured.source}", headings, tuple(rows))


def residuals(name: str, e: Estimate) -> Sheet:
    """Root mean square residual and noise of a fit, by channel."""
    rows = []
    for channel in dict.fromkeys([*e.rmse, *e.noise]):
        scale, unit = _RESIDUALS.get(channel, as_read(e.readings.get(channel, "N")))
        cells = [number(scale * values[channel]) if channel in values else "–" for values in (e.rmse, e.noise)]
        rows.append((channel, *cells, unit))
    where = "given" if e.noise_known else "estimated from the residuals"
    headings = ("channel", "root mean square residual", f"noise, {where}", "unit")
    return Sheet(f"Residuals of {name}", headings, tuple(rows))


def checks(run: ReportedRun) -> Sheet:
    """Equilibrium, indentation, constraint drift and energy of a simulation, as far as its file has them."""
    rows = [
        (words, number(factor * float(run.about[key]), digits), unit)
        for words, key, factor, digits, unit in _CHECKS
        if key in run.about
    ]
    energies = {words: run.data[name].values for name, words in _ENERGIES.items() if name in run.data}
    rows += [(words, number(1e3 * np.nanmax(np.abs(values)), 3), "mJ") for words, values in energies.items()]
    return Sheet(f"Simulation: {run.name}", ("check", "value", "unit"), tuple(rows))


def fitted(e: Estimate, scene: Scene | None) -> Sheet:
    """Estimates with their intervals and standard deviations, also for each trial where they differ."""
    rows = []
    for i, name in enumerate(e.names[: e.shared]):
        scale, unit = as_read(e.units[i])
        value, sd, nominal = (scale * float(a[i]) for a in (e.values, e.standard_deviations, e.nominal))
        low, high = scale * e.intervals[i]
        uncertainty = f"{number(low)} to {number(high)}", number(sd, 3)
        if name in e.set_by_bounds:
            uncertainty = "not known", "not known"
        found = ", ".join(words for words in (number(value), e.bound_mark(name)) if words)
        rows.append((name, meaning(scene, name), found, *uncertainty, number(nominal), unit))
    for name, trials in e.in_trials.items():
        scale, unit = as_read(e.units[e.names.index(name)])
        for trial, (value, sd) in trials.items():
            cells = (number(scale * value), "", number(scale * sd, 3), "", unit)
            rows.append((f"{name} in {trial}", meaning(scene, name), *cells))
    against = "synthetic measurements" if e.synthetic else "measurements"
    headings = ("parameter", "meaning", "estimate", "95 % interval", "standard deviation", "nominal", "unit")
    return Sheet(f"Fitted to {against}", headings, tuple(rows))


def meaning(scene: Scene | None, name: str) -> str:
    """A parameter in words; its name if the scene is not known."""
    if scene is None:
        return name
    from pftwin.model.scene_parameters import find

    return " and ".join(n.replace("_", " ").replace(".", ", ", 1) for n in find(scene, name)[0].names)


def predicted(data: Dataset, most: int = 60) -> Sheet:
    """Outcomes of a prediction, with a row for each of at most `most` variants."""
    from fitting.prediction.plots import outcome_sheet

    return outcome_sheet(data, most)


def uncertainty_of_prediction(data: Dataset) -> list[str]:
    """Sentences on the uncertainty of a prediction: missing variants, main source of its bands, measured coverage."""
    from fitting.prediction.plots import coverage_in

    left = data.attrs.get("variants_missing")
    lines = [f"The prediction was interrupted: {int(left)} variants are missing."] if left else []
    if "sample" not in data.dims:
        return [*lines, "The prediction has no bands: it was made without draws from a fit's uncertainty."]
    return [*lines, *_widest_source(data), f"{coverage_in(data)}."]


def _widest_source(data: Dataset) -> list[str]:
    """The main source of a prediction's bands, in a sentence; empty if its draws do not determine it."""
    from fitting.prediction.band_sources import band_sources

    if "parameter_kind" not in data.coords:
        return []
    found = band_sources(data)
    finite = [row for row in zip(found.sources[:-1], found.narrower, strict=False) if np.isfinite(row[1]).all()]
    if not finite:
        return []
    name, shares = max(finite, key=lambda row: row[1].mean())
    if shares.mean() <= 0:
        return []
    names = data["parameter"].values[data["parameter_kind"].values == name]
    which = f" ({', '.join(map(str, names))})" if len(names) <= _MOST_NAMES else ""
    low, high = (f"{100 * share:.0f}" for share in (shares.min(), shares.max()))
    span = low if low == high else f"{low} to {high}"
    known = f"If this source were known, the bands would be {span} % narrower"
    return [f"Widest source of the bands: {name}{which}. {known}."]


def prediction_notes(data: Dataset) -> list[str]:
    """Notes on a prediction's table: parameters, meaning and coverage of its bands, invalid variants."""
    from fitting.prediction.plots import coverage_in, invalid_variants

    lines = [f"Parameters: {data.attrs.get('parameters', 'not in the file')}."]
    if "sample" in data.dims:
        draws = data.sizes["sample"] - 1
        lines.append(f"In brackets: 95 % interval over {draws} draws, without those that failed. {coverage_in(data)}.")
    if doubt := invalid_variants(data):
        lines.append(f"{doubt}: their rows are empty.")
    return lines


def tracking(runs: Sequence[ReportedRun]) -> Sheet:
    """Tracking of the patella in every run of the demo."""
    title = "Tracking of the patella, with nominal springs"
    return Sheet(title, ("case", "simulated"), tuple((run.name, run.tracking) for run in runs))


def errors(path: Path) -> Sheet:
    """Reads Table 2 of the study from the demo's folder; InputError for any other table."""
    lines = [csv_cells(line, path=path, number=i) for i, line in enumerate(read_lines(path)[0], 1) if line]
    if not lines or lines[0][:2] != ["row", "unit"] or any(len(line) != len(lines[0]) for line in lines):
        raise InputError("is not the demo's table", where=path, expected="the folder as `pftwin demo` wrote it")
    parts = (heading.partition("_") for heading in lines[0][2:])
    headings = (f"{case.replace('case', 'case ')}, {rest.replace('_', ' ')}" for case, _, rest in parts)
    caption = (
        "Errors of the fitted (case 2) and of the predicted motion (case 1) against the virtual rig's synthetic "
        "measurements; published: Table 2 of Michaud et al. 2024, on their rig"
    )
    rows = tuple((line[0], line[1], *map(_cell, line[2:])) for line in lines[1:])
    return Sheet(caption, ("", "unit", *headings), rows)


def _cell(text: str) -> str:
    try:
        return number(float(text), 3) if text else "–"
    except ValueError:
        return text


def versions(command: str, now: str) -> Sheet:
    """Date, command line and software versions of this report."""
    from pftwin.base.runtime import describe

    with_ = describe()
    made = {"date": now, "command": command, "pftwin": str(with_["pftwin"]), "JAX": str(with_["jax"])}
    made |= {"NumPy": np.__version__, "Python": f"{with_['python']} ({with_['system']})"}
    return Sheet("This report", ("made with", "value"), tuple(made.items()))


def settings(title: str, about: dict[str, Any], words: dict[str, str]) -> Sheet:
    """Settings of a simulation or prediction: those attributes of its file that `words` gives a label."""
    found = ((shown, about[key]) for key, shown in words.items() if key in about)
    rows = tuple((shown, value if isinstance(value, str) else f"{value:g}") for shown, value in found)
    return Sheet(title, ("setting", "value"), rows)


def fit(name: str, e: Estimate) -> Sheet:
    """Method, objective, channels, counts and bounds of a fit."""
    bounds = zip(e.names, e.lower, e.upper, e.units, strict=True)
    within = (f"{n} {number(low)} to {number(high)} {unit}".rstrip() for n, low, high, unit in bounds)
    objective = f"{e.objective}, {number(e.objective_value, 6)} {e.objective_unit}"
    counts = ((what, str(getattr(e, what))) for what in ("seed", "starts", "iterations", "evaluations"))
    rows = (("method", e.method), ("objective", objective), ("channels", ", ".join(e.channels)), *counts)
    last = (("bounds", "; ".join(within)), ("versions", "not in the estimate's file"))
    return Sheet(f"Fit: {name}", ("setting", "value"), (*rows, *last))


def files(paths: Sequence[Path]) -> Sheet:
    """Files that a report was made from, with size, checksum and time of last change."""
    rows = []
    for path in paths:
        about, digest = path.stat(), hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        rows.append((path.name, f"{about.st_size:,}", digest, stamp(datetime.fromtimestamp(about.st_mtime, UTC))))
    return Sheet("Files that this report was made from", ("file", "bytes", "SHA-256", "last changed"), tuple(rows))


def stamp(moment: datetime) -> str:
    """Formats a date and time (UTC) to the minute."""
    return moment.strftime("%Y-%m-%d %H:%M UTC")


def _words(name: str) -> str:
    return name.replace("_", " ")
