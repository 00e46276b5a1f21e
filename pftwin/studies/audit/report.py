"""Explanations and audits as tables of text, for the terminal and for Markdown, with notes on how to read them.

An audit as columns with units: for CSV, NetCDF and pages.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pftwin.base.labels import SYNTHETIC
from pftwin.base.sheet import Sheet
from pftwin.studies.audit.audit import Audit
from pftwin.studies.audit.explain import Explanation, PartCost
from pftwin.studies.tables import Column, short, to_dataset

if TYPE_CHECKING:
    from xarray import Dataset


_SHOWN = (
    ("path_rms_mm", "path rms [mm]"),
    ("path_max_mm", "max [mm]"),
    ("flexion_rms_deg", "flexion [deg]"),
    ("rotation_rms_deg", "rotation"),
    ("tilt_rms_deg", "tilt"),
    ("contact_rms_N", "contact rms [N]"),
    ("tension_rms_N", "tension rms [N]"),
)
_LONG = 1.0  # [s]: steps beyond are no limit


def explanation_sheet(found: Explanation) -> Sheet:
    """A row for each part, one for what they share, and the whole."""
    headings = ("effect", "computed by", "equations", "share of time", "explicit up to", "stiff")
    rows = [_part(part) for part in found.parts]
    rest = ("inertia, guided motion, solution", "", f"{found.shared_equations}", f"{found.shared_time:.0%}")
    whole = ("one step", "", f"{found.equations}", f"{1e6 * found.step_time:.2f} us", "", "")
    rows += [(*rest, *[""] * 5), (*whole, f"{1e3 * found.kinetic_change:+.2g} mJ kinetic", "", "")]
    notes = [
        "equations, share of time: what goes when the effect is left out; the rest is negative where leaving out one "
        "simplifies what others share",
        f"explicit up to: the longest step of an explicit method at the worst moment; stiff: below {_ms(found.step)}",
        f"energy over {found.steps} steps; the effects' works miss the change of kinetic energy by "
        f"{1e3 * found.energy_gap:.2g} mJ; {found.programs} programs compiled",
    ]
    if found.status:
        notes.append(f"status: {found.status.describe()}")
    return Sheet(
        f"{found.scene}: {found.integrator}, steps of {_ms(found.step)}",
        (*headings, "work on patella", "moved", "heat"),
        tuple(rows),
        (*["part"] * len(found.parts), "rest", "rest"),
        (0, 1, 5),
        tuple(notes),
    )


def _part(part: PartCost) -> tuple[str, ...]:
    return (
        part.name if part.of is None else f"- of which {part.name.removeprefix(part.of + ': ')}",
        part.kind,
        f"{part.equations:+d}",
        f"{part.share:.1%} ± {part.spread:.1%}",
        "any" if part.longest_step > _LONG else _ms(part.longest_step),
        "yes" if part.stiff else "no",
        *(_energy(x) for x in (part.work, part.moved, part.heat)),
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms"


def _energy(joules: float) -> str:
    if not math.isfinite(joules):
        return "not finite"
    return f"{1e3 * joules:,.0f} mJ" if abs(joules) >= 0.1 else f"{1e3 * joules:.2g} mJ"


def audit_sheet(found: Audit) -> Sheet:
    """A row for each variant."""
    figures = {c.key: c.values for c in columns(found)}
    rows = []
    for i, row in enumerate(found.rows):
        numbers = (_number(figures[key][i]) for key, _ in _SHOWN)
        rows.append((row.kind, row.name, *numbers, _time(row.cost, row.spread), row.verdict, row.outcome))
    notes = [f"{row.name}: {row.sentence}" for row in found.rows if row.kind != "left out"]
    notes += [f"not applicable: {v.name} ({v.kind}): {v.reason}" for v in found.not_applicable]
    notes.append(
        f"verdicts by the largest distance from the scene's own path, against {1e3 * found.tolerance:g} mm; angles are "
        "rms; time: share of the scene's run that it takes, - where several ran side by side; "
        f"{found.programs} programs compiled"
    )
    notes += [interruption(found)] if found.interrupted else []
    notes += [] if found.tracking is None else [f"the scene itself: {found.tracking}"]
    notes += [SYNTHETIC] if found.synthetic else []
    notes += [f"status: {found.status}"] if found.status != "ok" else []
    pace = "interrupted" if found.run_time is None else f"a run takes {1e3 * found.run_time:.1f} ms"
    return Sheet(
        f"{found.scene}: {found.integrator}, steps of {_ms(found.step)}, {pace}",
        ("change", "what", *(heading for _, heading in _SHOWN), "time", "verdict", "outcome"),
        tuple(rows),
        tuple(row.kind for row in found.rows),
        (0, 1, 10, 11),
        tuple(notes),
    )


def _number(value: float) -> str:
    return "0" if abs(value) < 1e-6 else short(value)


def _time(cost: float | None, spread: float | None) -> str:
    return "-" if cost is None or spread is None else f"{cost:+.0%} ± {spread:.0%}"


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
