"""An audit as a table of columns with units: for CSV, NetCDF and Markdown."""

from __future__ import annotations

import csv
import os
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pftwin.output import written_whole
from pftwin.studies.audit.audit import Audit, Worth

if TYPE_CHECKING:
    from xarray import Dataset


class Column(NamedTuple):
    """A figure of every row."""

    key: str  # with its unit, as files have it
    unit: str
    long_name: str
    values: tuple[float, ...]  # NaN where there is none


def columns(found: Audit) -> list[Column]:
    """All figures, in the units of a reader: mm, deg, N, percent."""

    def of(key: str, unit: str, long_name: str, field: str, factor: float = 1.0) -> Column:
        values = (None if row.changes is None else getattr(row.changes, field) for row in found.rows)
        return Column(key, unit, long_name, tuple(np.nan if v is None else factor * v for v in values))

    degrees = float(np.degrees(1.0))
    return [
        of("path_rms_mm", "mm", "distance of the tracked point from its own path, rms", "center_rms", 1e3),
        of("path_max_mm", "mm", "distance of the tracked point from its own path, largest", "center_max", 1e3),
        of("flexion_rms_deg", "deg", "change of patellar flexion, rms", "flexion", degrees),
        of("rotation_rms_deg", "deg", "change of patellar rotation, rms", "rotation", degrees),
        of("tilt_rms_deg", "deg", "change of patellar tilt, rms", "tilt", degrees),
        of("contact_rms_N", "N", "change of the contact force, rms", "contact_rms"),
        of("contact_max_N", "N", "change of the contact force, largest", "contact_max"),
        of("tension_rms_N", "N", "change of the tension that changes most, rms", "tension_rms"),
        of("tension_max_N", "N", "change of that tension, largest", "tension_max"),
        Column("time_percent", "percent", "time that it takes, of the scene's run", _percent(found, "cost")),
        Column("time_spread_percent", "percent", "half of the rounds' middle half", _percent(found, "spread")),
    ]


def _percent(found: Audit, field: str) -> tuple[float, ...]:
    values = (getattr(row, field) for row in found.rows)
    return tuple(np.nan if v is None else 100 * v for v in values)


def words(row: Worth) -> dict[str, str]:
    """What is said of a row."""
    return {
        "change": row.kind,
        "what": row.name,
        "verdict": row.verdict,
        "outcome": row.outcome,
        "tension_of": (row.changes.tension_of if row.changes else None) or "",
        "sentence": row.sentence,
    }


def interruption(found: Audit) -> str:
    """What is missing of an audit that was interrupted."""
    missing = f"not run: {', '.join(found.missing)}" if found.missing else "all variants run"
    return f"interrupted; {missing}; times were not measured"


def write_csv(found: Audit, path: str | os.PathLike[str]) -> None:
    """A row for each variant; empty cells where there is nothing to compare.

    Raises:
        OutputError: the file cannot be written.
    """
    figures = columns(found)
    with written_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        sheet = csv.writer(file)
        said = [words(row) for row in found.rows]
        sheet.writerow(["change", "what", *(c.key for c in figures), "verdict", "outcome", "tension_of", "sentence"])
        for i, row in enumerate(said):
            cells = ["" if np.isnan(c.values[i]) else f"{c.values[i]:.6g}" for c in figures]
            tail = [row[k] for k in ("verdict", "outcome", "tension_of", "sentence")]
            sheet.writerow([row["change"], row["what"], *cells, *tail])


def dataset(found: Audit) -> Dataset:
    """The same with units on every variable."""
    from xarray import Dataset

    said = [words(row) for row in found.rows]
    variables = {
        c.key: ("variant", np.array(c.values), {"units": c.unit, "long_name": c.long_name}) for c in columns(found)
    }
    texts = {
        key: ("variant", [row[key] for row in said])
        for key in ("change", "verdict", "outcome", "tension_of", "sentence")
    }
    about = {
        "scene": found.scene,
        "integrator": found.integrator,
        "step_s": found.step,
        "tolerance_m": found.tolerance,
        "run_time_s": np.nan if found.run_time is None else found.run_time,
        "status": found.status,
        "tracking": found.tracking or "",
        "not_applicable": "; ".join(f"{v.name}: {v.reason}" for v in found.not_applicable),
        **({"interrupted": interruption(found)} if found.interrupted else {}),
    }
    return Dataset({**variables, **texts}, coords={"variant": [row["what"] for row in said]}, attrs=about)


def write_netcdf(found: Audit, path: str | os.PathLike[str]) -> None:
    """The dataset as a file.

    Raises:
        OutputError: the file cannot be written.
    """
    from pftwin.result_files import save_dataset

    save_dataset(dataset(found), path)
