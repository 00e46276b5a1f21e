"""Reports of explanations and audits: text tables with notes, columns with units for files, and bar charts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.quantities import annotated
from pftwin.base.sheet import Column, Sheet, short_number, to_dataset
from pftwin.model.measured import SYNTHETIC
from pftwin.results.plots import style
from pftwin.studies.audit.audit import Audit, Worth
from pftwin.studies.audit.explain import Explanation, PartCost
from pftwin.studies.audit.runs import Changes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
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
_LONG = 1.0  # longer stable steps are shown as "any" [s]


def explanation_sheet(found: Explanation) -> Sheet:
    """Returns a table with a row for each part, one for the shared rest, and one for the whole step."""
    headings = (
        "effect", "computed by", "equations", "time [%]", "longest explicit step [ms]", "stiff", "work [mJ]",
        "absolute work [mJ]", "heat [mJ]",
    )  # fmt: skip
    rows = [_part(part) for part in found.parts]
    rest = ("inertia, prescribed motion, solver", "", f"{found.shared_equations}", f"{100 * found.shared_time:.0f}")
    rows += [(*rest, *[""] * 5), ("whole step", "", f"{found.equations}", "100", *[""] * 5)]
    notes = [
        f"equations, time: what a step, of {1e6 * found.step_time:.2f} us, saves without the effect; savings overlap, "
        "so what is left for the rest can be negative",
        "longest explicit step: that an explicit method with this effect alone could take at the worst moment; stiff: "
        f"shorter than the step of {_ms(found.step)}",
        f"work: on the patella, over {found.steps} steps; absolute work: with work in both directions counted as "
        "positive; heat: lost to damping and friction",
        f"works add up to the change of kinetic energy, {_energy(found.kinetic_change)} mJ, with an error of "
        f"{_energy(found.energy_gap)} mJ; {found.programs} programs compiled",
    ]
    if found.status:
        notes.append(f"status: {found.status.describe()}")
    doubt = "" if found.verdict == "valid" else f"{found.verdict}\n"
    title = f"{doubt}{found.scene}: {found.integrator}, steps of {_ms(found.step)}"
    groups = (*["part"] * len(found.parts), "rest", "rest")
    return Sheet(title, headings, tuple(rows), groups, (0, 1, 5), tuple(notes))


def _part(part: PartCost) -> tuple[str, ...]:
    return (
        part.name if part.of is None else f"- of which {part.name.removeprefix(part.of + ': ')}",
        part.kind,
        f"{part.equations}",
        f"{100 * part.share:.1f} ± {100 * part.spread:.1f}",
        "any" if part.longest_step > _LONG else f"{1e3 * part.longest_step:.2g}",
        "yes" if part.stiff else "no",
        *(_energy(x) for x in (part.work, part.moved, part.heat)),
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms"


def _energy(joules: float) -> str:
    """An energy in mJ; less than a nanojoule, of rounding, is 0."""
    if not math.isfinite(joules):
        return "not finite"
    return "0" if abs(joules) < 1e-9 else f"{1e3 * joules:,.0f}" if abs(joules) >= 0.1 else f"{1e3 * joules:.2g}"


def audit_sheet(found: Audit) -> Sheet:
    """Returns a table with a row for each variant."""
    figures = {c.key: c.values for c in columns(found)}
    rows = []
    for i, row in enumerate(found.rows):
        numbers = (_number(figures[key][i]) for key, _ in _SHOWN)
        rows.append((row.kind, row.name, *numbers, _time(row.cost, row.spread), row.verdict, row.outcome))
    notes = [f"{row.name}: {row.sentence}" for row in found.rows if row.kind != "left out"]
    notes += [f"not applicable: {v.name} ({v.kind}): {v.reason}" for v in found.not_applicable]
    notes.append(
        f"verdicts by the largest distance from the scene's own path, against {1e3 * found.tolerance:g} mm; angles are "
        "rms; time: share of the scene's run that it takes, - where several ran in one batch; "
        f"{found.programs} programs compiled"
    )
    notes += [f"restitution: {found.impact}"] if found.impact else []
    notes += [interruption(found)] if found.interrupted else []
    notes.append(f"the scene itself: {found.tracking}")
    notes += [SYNTHETIC] if found.synthetic else []
    notes += [f"status: {found.status}"] if found.status != "ok" else []
    pace = "interrupted" if found.run_time is None else f"a run takes {1e3 * found.run_time:.1f} ms"
    doubt = "" if found.verdict == "valid" else f"{found.verdict}\n"
    return Sheet(
        f"{doubt}{found.scene}: {found.integrator}, steps of {_ms(found.step)}, {pace}",
        ("change", "what", *(heading for _, heading in _SHOWN), "time", "verdict", "outcome"),
        tuple(rows),
        tuple(row.kind for row in found.rows),
        (0, 1, 10, 11),
        tuple(notes),
        keys=2,
    )


def _number(value: float) -> str:
    return "0" if abs(value) < 1e-6 else short_number(value)


def _time(cost: float | None, spread: float | None) -> str:
    return "-" if cost is None or spread is None else f"{cost:+.0%} ± {spread:.0%}"


def columns(found: Audit) -> list[Column]:
    """Returns all numeric columns, in mm, deg, N and percent."""
    return [*_columns(Changes, [row.changes for row in found.rows]), *_columns(Worth, found.rows)]


def _columns(kind: type, rows: Sequence[Any]) -> Iterator[Column]:
    for name, (key, unit, factor, long_name) in annotated(kind).items():
        values = (None if row is None else getattr(row, name) for row in rows)
        yield Column(key, [np.nan if v is None else factor * v for v in values], unit, long_name)


def table(found: Audit) -> list[Column]:
    """Returns all columns: the change, the numeric columns and the verdict."""
    rows = found.rows
    first = Column("change", [r.kind for r in rows]), Column("what", [r.name for r in rows])
    tensions = Column("tension_of", [(r.changes.tension_of if r.changes else None) or "" for r in rows])
    verdict, outcome, sentence = (Column(k, [getattr(r, k) for r in rows]) for k in ("verdict", "outcome", "sentence"))
    return [*first, *columns(found), verdict, outcome, tensions, sentence]


def interruption(found: Audit) -> str:
    """Describes what an interrupted audit lacks."""
    missing = f"not run: {', '.join(found.missing)}" if found.missing else "all variants run"
    return f"interrupted; {missing}; times were not measured"


def dataset(found: Audit) -> Dataset:
    """Returns all columns as a dataset along the variants, with units on every variable."""
    about = {
        "scene": found.scene,
        "integrator": found.integrator,
        "step_s": found.step,
        "tolerance_m": found.tolerance,
        "run_time_s": np.nan if found.run_time is None else found.run_time,
        "status": found.status,
        "verdict": found.verdict,
        "tracking": found.tracking,
        "not_applicable": "; ".join(f"{v.name}: {v.reason}" for v in found.not_applicable),
        **({"interrupted": interruption(found)} if found.interrupted else {}),
    }
    return to_dataset(table(found), "variant", about, names="what")


_COLOUR = {"left out": style.COLOURS[0], "added": style.COLOURS[1], "changed": style.COLOURS[2], "yardstick": "0.55"}
_MOST = 150.0  # larger shares of time are outside the axis and written as numbers [%]
_LEAST = 1e-3  # smaller changes are drawn as zero [mm], [N]
_BESIDE: dict[str, Any] = {"xytext": (4, 0), "textcoords": "offset points", "va": "center", "fontsize": style.SMALL}


def audit_figure(found: Audit, title: str) -> Figure:
    """Plots bars for each variant: distance from the scene's own path, change of contact force, and time."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    data = {c.key: c for c in columns(found)}
    rows = found.rows
    with style.house_style():
        figure = Figure(figsize=(style.WIDE, 1.6 + 0.34 * len(rows)))
        path, force, time = figure.subplots(1, 3, sharey=True, width_ratios=[1.5, 1.2, 1.0])
        _bars(path, rows, data["path_rms_mm"], data["path_max_mm"])
        limit = 1e3 * found.tolerance
        path.axvline(limit, color="black", linestyle=(0, (4, 2)), linewidth=1.0)
        path.annotate(f"tolerance {limit:g} mm", (limit, -0.75), annotation_clip=False, **{**_BESIDE, "xytext": (3, 0)})
        _bars(force, rows, data["contact_rms_N"], data["contact_max_N"])
        _time_bars(time, rows, data["time_percent"], data["time_spread_percent"])
        path.set_yticks(range(len(rows)), [style.shortened(row.name) for row in rows])
        path.set_ylim(len(rows) - 0.4, -1.1)
        path.set(title="Path: bar rms, line to the largest", xlabel="distance from the scene's own path [mm]")
        force.set(title="Contact force: bar rms, line to the largest", xlabel="change [N]")
        time.set(title="Time that it takes", xlabel="share of the scene's run [%]")
        for axes in (path, force, time):
            axes.grid(False, axis="y")
            axes.set_axisbelow(True)
        shown = [k for k in _COLOUR if any(r.kind == k for r in rows)]
        patches = [Patch(color=_COLOUR[k], label=k) for k in shown]
        style.title(figure, title)
        style.footer(figure, SYNTHETIC if found.synthetic else None)
        style.legend_below(figure, patches, shown)
    return figure


def _bars(axes: Axes, rows: tuple[Worth, ...], rms: Column, largest: Column) -> None:
    """Draws bars on a logarithmic axis that starts at `_LEAST`."""
    from matplotlib.ticker import NullFormatter

    ends = np.array(largest.values)
    high = max(10 * _LEAST, np.nanmax(ends, initial=_LEAST))
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(_LEAST, 2 * high)
    for i, row in enumerate(rows):
        if row.changes is None:
            box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
            axes.annotate(row.outcome, (_LEAST, i), color=_COLOUR[row.kind], bbox=box, **_BESIDE)
            continue
        if np.isnan(rms.values[i]):
            axes.annotate("none", (_LEAST, i), **_BESIDE)
            continue
        axes.barh(i, max(rms.values[i], _LEAST), height=0.6, left=0, color=_COLOUR[row.kind])
        axes.plot([max(rms.values[i], _LEAST), max(ends[i], _LEAST)], [i, i], color=_COLOUR[row.kind], linewidth=1.6)
        if ends[i] < _LEAST:
            axes.annotate(f"below {_LEAST:g}", (_LEAST, i), **_BESIDE)


def _time_bars(axes: Axes, rows: tuple[Worth, ...], share: Column, spread: Column) -> None:
    """Draws bars of time; shares outside the axis are written as numbers."""
    inside = [v for v in share.values if abs(v) <= _MOST]
    low, high = min(-10.0, *inside), max(10.0, *inside)
    margin = 0.15 * (high - low)
    axes.set_xlim(low - margin, high + margin)
    axes.axvline(0, color="black", linewidth=0.8)
    for i, row in enumerate(rows):
        value = share.values[i]
        if np.isnan(value):
            axes.annotate("not timed (batch)", (0, i), **_BESIDE)
            continue
        drawn = float(np.clip(value, *axes.get_xlim()))
        axes.barh(i, drawn, height=0.6, color=_COLOUR[row.kind], alpha=1.0 if drawn == value else 0.35)
        if drawn == value:
            axes.errorbar(value, i, xerr=spread.values[i], color="black", linewidth=0.8, capsize=2)
        else:  # there is space to the right of zero, possibly on a pale bar
            words = f"{value:+,.0f} %".replace("-", "\N{MINUS SIGN}")
            axes.annotate(words, (0, i), **_BESIDE)
