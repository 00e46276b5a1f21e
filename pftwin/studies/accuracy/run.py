"""Runs a plan of the accuracy study on a scene and writes the results; keeps rows measured before a failure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from pftwin.base.sheet import Sheet
from pftwin.base.text_files import write_text
from pftwin.files.result_files import save_dataset
from pftwin.model.measured import Measured
from pftwin.results.metrics import PAPER_TABLE_1, Validation, validate
from pftwin.results.plots import save_figure
from pftwin.studies.accuracy.measure import AccuracyRow, Converged, SceneOf, compiling_anew, converged, rows
from pftwin.studies.accuracy.programs import MeasuredProgram
from pftwin.studies.accuracy.table import advice, all_figures, columns, work_precision
from pftwin.studies.runs import run_each
from pftwin.studies.tables import to_csv, to_dataset


@dataclass(frozen=True)
class AccuracyMeasured:
    """Results of an accuracy study."""

    rows: list[AccuracyRow]
    references: dict[str, Converged]  # converged runs by contact
    models: dict[str, Validation]  # errors of the converged runs by contact; empty without measurements


def measure_all(
    plan: Sequence[MeasuredProgram],
    scene_of: SceneOf,
    measured: Measured | None,
    tell: Callable[[str], None],
    keep: Callable[[list[AccuracyRow]], None] = lambda _: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> AccuracyMeasured:
    """Measures all settings of a plan, each against the converged run of its contact and optional measurements.

    `tell` is called with a message before each piece of work, `progress` with the number of settings done and their
    total, and `keep` with all rows so far after each setting, to store them.
    """
    references: dict[str, Converged] = {}

    def before(k: int, setting: MeasuredProgram) -> None:
        progress(k, len(plan))
        if setting.contact not in references:
            tell(f"{setting.contact}: converged run")
            with jax.enable_x64(True):
                references[setting.contact] = converged(scene_of(setting.contact), setting.contact)
        tell(f"{k + 1} of {len(plan)}: {setting.contact}, {setting.integrator}, {setting.dtype}")

    def one(setting: MeasuredProgram) -> list[AccuracyRow]:
        with jax.enable_x64(setting.dtype == "float64"):
            return rows(setting, scene_of(setting.contact), references[setting.contact], measured)

    with compiling_anew():
        found = run_each(plan, one, before=before, after=lambda pieces: keep([r for p in pieces for r in p]))
    if len(found) < len(plan):
        raise KeyboardInterrupt  # `keep` has the measured rows
    models = {} if measured is None else {c: _against(r, measured) for c, r in references.items()}
    return AccuracyMeasured([row for piece in found for row in piece], references, models)


def _against(reference: Converged, measured: Measured) -> Validation:
    tibial, femoral = (n if n in reference.result.effects else None for n in ("patellar_tendon", "quadriceps"))
    return validate(reference.result, measured, tibial=tibial, femoral=femoral)


def write(found: AccuracyMeasured, folder: Path, title: str, about: dict[str, Any]) -> list[Path]:
    """Writes accuracy.nc, accuracy.csv, accuracy.md and a figure for each contact model; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = netcdf, csv, markdown = [folder / f"accuracy.{kind}" for kind in ("nc", "csv", "md")]
    save_dataset(to_dataset(columns(found.rows), "setting", about), netcdf)
    write_text(csv, to_csv(columns(found.rows)))
    write_text(markdown, report(found, title, about))
    for contact in found.references:
        figure = work_precision(found.rows, f"{title}, {contact}: what accuracy costs", contact=contact)
        paths += save_figure(figure, folder / f"accuracy_{contact}")
    return paths


def report(found: AccuracyMeasured, title: str, about: dict[str, Any]) -> str:
    """Returns the report in Markdown."""
    doubts = "; ".join(f"{c} {r.doubt_mm:.1g} mm" for c, r in found.references.items())
    parts = [
        f"# {title}: what accuracy costs in time",
        "; ".join(f"{k}: {v}" for k, v in about.items()),
        "Errors are from the converged run of the same contact model; how far a second integrator's converged run"
        f" is from it, rms: {doubts}.",
        "## Recommended settings",
        advice(found.rows).grid(),
        *_models(found.models),
        "## Everything measured",
        all_figures(found.rows).grid(),
    ]
    return "\n\n".join(parts) + "\n"


def _models(models: dict[str, Validation]) -> list[str]:
    """The section with the converged runs in the rows of the paper's Table 1."""
    if not models:
        return []
    synthetic = any(v.synthetic for v in models.values())
    keep = ("initial_configuration", "real_time_factor")
    rows = [[r for r in v.to_rows(c if c in PAPER_TABLE_1 else None) if r.key not in keep] for c, v in models.items()]
    cells = [
        [("-" if r.value is None else f"{r.value:.3g}") + ("" if r.paper is None else f" ({r.paper:g})") for r in same]
        for same in zip(*rows, strict=True)
    ]
    labels = [f"{r.label}, {r.unit}" for r in rows[0]]
    sheet = Sheet("", ("", *models), tuple((a, *b) for a, b in zip(labels, cells, strict=True)))
    return [
        "## Error of the contact models",
        f"Converged runs against the {'SYNTHETIC ' if synthetic else ''}measurements; in brackets the paper's means"
        " over its four cases, with its own rig and measurements (Michaud et al. 2024, Table 1).",
        sheet.grid(),
    ]
