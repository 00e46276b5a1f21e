"""An audit as columns with units: for CSV, NetCDF and pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pftwin.studies.audit.audit import Audit
from pftwin.studies.tables import Column, to_dataset

if TYPE_CHECKING:
    from xarray import Dataset


def columns(found: Audit) -> list[Column]:
    """All figures, in the units of a reader: mm, deg, N, percent."""

    def of(key: str, unit: str, long_name: str, field: str, factor: float = 1.0) -> Column:
        values = (None if row.changes is None else getattr(row.changes, field) for row in found.rows)
        return Column(key, [np.nan if v is None else factor * v for v in values], unit, long_name)

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
        Column("time_percent", _percent(found, "cost"), "percent", "time that it takes, of the scene's run"),
        Column("time_spread_percent", _percent(found, "spread"), "percent", "half of the rounds' middle half"),
    ]


def _percent(found: Audit, field: str) -> list[float]:
    values = (getattr(row, field) for row in found.rows)
    return [np.nan if v is None else 100 * v for v in values]


def table(found: Audit) -> list[Column]:
    """The figures between what was changed and what is said of it."""
    rows = found.rows
    first = Column("change", [r.kind for r in rows]), Column("what", [r.name for r in rows])
    tensions = Column("tension_of", [(r.changes.tension_of if r.changes else None) or "" for r in rows])
    verdict, outcome, sentence = (Column(k, [getattr(r, k) for r in rows]) for k in ("verdict", "outcome", "sentence"))
    return [*first, *columns(found), verdict, outcome, tensions, sentence]


def interruption(found: Audit) -> str:
    """What is missing of an audit that was interrupted."""
    missing = f"not run: {', '.join(found.missing)}" if found.missing else "all variants run"
    return f"interrupted; {missing}; times were not measured"


def dataset(found: Audit) -> Dataset:
    """All columns, with units on every variable, along the variants."""
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
    return to_dataset(table(found), "variant", about, names="what")
