"""Tables, figures and files of the accuracy study: all settings, the Pareto front, and recommended settings."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_type_hints

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.quantities import annotated
from pftwin.base.sheet import Column, Sheet, short_number, to_csv, to_dataset
from pftwin.base.text_files import read_lines, write_text
from pftwin.files.result_files import save_dataset
from pftwin.results.metrics import PAPER_TABLE_1, Validation
from pftwin.results.plots import save_figure
from pftwin.results.plots.style import COLOURS, MARKERS, TINY, WIDE, house_style, legend_below
from pftwin.results.plots.style import title as set_title
from pftwin.studies.accuracy.measure import AccuracyMeasured, AccuracyRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVELS = (0.2, 0.1, 0.05, 0.01, 0.001)  # rms errors for which settings are recommended [mm]
ALIKE = 0.9  # ratio of two speeds that counts as equal, because timing is noisy
_NEEDED = ("contact", "integrator", "dtype", "status", "order", "step_ms", "position_rms_mm", "real_time")


class Advice(NamedTuple):
    """The fastest setting within an rms error."""

    level_mm: float
    row: AccuracyRow | None  # fastest for one run; None: no measured setting is that accurate
    best_batch: AccuracyRow | None  # fastest for a batch


def columns(rows: Sequence[AccuracyRow]) -> list[Column]:
    """Returns all fields of the rows except `status_frames` as columns, with units in the names."""
    about, names = annotated(AccuracyRow), [f.name for f in fields(AccuracyRow) if f.name != "status_frames"]
    return [Column(n, [getattr(r, n) for r in rows], *about.get(n, ())) for n in names]


def read_csv(path: str | os.PathLike[str]) -> list[AccuracyRow]:
    """Reads a saved table, also from a version with fewer columns: a missing number becomes NaN.

    Lines that start with # are skipped. Raises InputError if the file is missing or lacks required columns.
    """
    lines = read_lines(path)[0]
    kinds = {n: kind for n, kind in get_type_hints(AccuracyRow).items() if kind in (str, int, float)}
    found = []
    for number, cells in enumerate(csv.DictReader(x for x in lines if not x.startswith("#")), start=1):
        if missing := [n for n in _NEEDED if cells.get(n) is None or (kinds[n] is str and not cells[n])]:
            raise InputError(f"row {number} has no {missing[0]}", where=path, expected="a table of pftwin accuracy")
        try:
            values: dict[str, Any] = {
                n: kind(cells.get(n) or ("" if kind is str else "nan")) for n, kind in kinds.items()
            }
        except ValueError as error:
            raise InputError(f"row {number}: {error}", where=path, expected="numbers") from error
        found.append(AccuracyRow(**values))
    return found


def front(rows: Iterable[AccuracyRow], speed: str = "real_time") -> list[AccuracyRow]:
    """Returns the Pareto front: settings such that no other is both faster and more accurate, fastest first."""
    usable = [r for r in rows if np.isfinite(r.position_rms_mm) and np.isfinite(getattr(r, speed))]
    best, found = np.inf, []
    for row in sorted(usable, key=lambda r: (-getattr(r, speed), r.position_rms_mm)):
        if row.position_rms_mm < best:
            best = row.position_rms_mm
            found.append(row)
    return found


def recommended(rows: Sequence[AccuracyRow], levels: Sequence[float] = LEVELS) -> list[Advice]:
    """Returns the fastest setting for each error level, for one run and for a batch; among equally fast settings,
    double precision comes first, then accuracy.
    """

    def fastest(level: float, speed: str) -> AccuracyRow | None:
        within = [r for r in rows if r.position_rms_mm <= level and np.isfinite(getattr(r, speed))]
        enough = ALIKE * max((getattr(r, speed) for r in within), default=0.0)
        fast = [r for r in within if getattr(r, speed) >= enough]
        return min(fast, key=lambda r: (r.dtype == "float32", r.position_rms_mm), default=None)

    return [Advice(level, fastest(level, "real_time"), fastest(level, "real_time_batch")) for level in levels]


def advice(rows: Sequence[AccuracyRow]) -> Sheet:
    """Returns a table of the fastest setting for each rms error, for one run and for 64 in a batch, with its errors."""
    found = []
    for level, one, many in recommended(rows):
        for kind, row, speed in (("one run", one, "real_time"), ("64 runs", many, "real_time_batch")):
            cells = ("none measured", *"---")
            if row is not None:
                figures = getattr(row, speed), row.position_max_mm, row.force_rms_n
                cells = (described(row), *map(short_number, figures))
            found.append((f"{level:g} mm" if kind == "one run" else "", kind, *cells))
    title = "Recommended: the fastest that was measured within an error"
    headings = ("rms", "", "setting", "x real time", "max, mm", "force, N")
    return Sheet(title, headings, tuple(found), words=(0, 1, 2))


def all_figures(rows: Sequence[AccuracyRow]) -> Sheet:
    """Returns a table of all numbers of all rows."""
    headings = (
        "contact", "integrator", "float", "step, ms", "position rms (max), mm", "tilt, deg", "force, N",
        "dislocation, ms", "from measurements, mm", "x real time", "64 side by side", "compile, s", "derivatives",
        "status",
    )  # fmt: skip
    found = []
    for r in rows:
        position = f"{short_number(r.position_rms_mm)} ({short_number(r.position_max_mm)})"
        figures = (r.tilt_rms_deg, r.force_rms_n, r.dislocation_ms, r.measured_mm)
        speeds = (r.real_time, r.real_time_batch, r.compile_s, r.gradient)
        named = (r.contact, r.integrator, r.dtype, f"{r.step_ms:g}", position)
        found.append((*named, *map(short_number, (*figures, *speeds)), r.status))
    return Sheet("Everything measured", headings, tuple(found))


def overview(rows: Sequence[AccuracyRow]) -> Sheet:
    """Returns a table of the columns that fit a terminal; the files have all columns."""
    found, groups = [], []
    for r in rows:
        name = f"{r.contact}, {r.integrator}, {r.dtype}"
        if name not in groups[-1:]:
            found.append((name, *[""] * 5))
            groups.append(name)
        figures = (r.position_rms_mm, r.position_max_mm, r.force_rms_n, r.real_time, r.real_time_batch)
        found.append((f"  {r.step_ms:g}", *map(short_number, figures)))
        groups.append(name)
    title = "Errors from the converged run of the same contact; speed in times real time"
    headings = ("step, ms", "rms, mm", "max, mm", "force, N", "one run", "64 runs")
    return Sheet(title, headings, tuple(found), tuple(groups), words=(0,))


def described(row: AccuracyRow) -> str:
    """Describes a setting in words."""
    single = "" if row.dtype == "float64" else ", float32"
    return f"{row.contact}, {row.integrator}, {row.step_ms:g} ms{single}"


PANELS = (("real_time", "one run"), ("real_time_batch", "64 variants side by side"))


def work_precision(rows: Sequence[AccuracyRow], title: str, *, contact: str | None = None) -> Figure:
    """Plots error over time for one run and for a batch, with a line over the steps for each integrator.

    Draws the rows of one contact, by default that of the first row, in float64 if available. Raises InputError if there
    are no rows.
    """
    from matplotlib.figure import Figure

    if not rows:
        raise InputError("nothing to draw", where="work_precision", expected="at least one row")
    wanted = contact or rows[0].contact
    own = [r for r in rows if r.contact == wanted and np.isfinite(r.position_rms_mm) and r.position_rms_mm > 0]
    own = [r for r in own if r.dtype == "float64"] or own
    panels = [p for p in PANELS if any(np.isfinite(getattr(r, p[0])) for r in own)]
    with house_style():
        figure = Figure(figsize=(0.5 * WIDE * max(1, len(panels)), 4.6))
        axes = figure.subplots(1, max(1, len(panels)), squeeze=False, sharey=True)[0]
        for ax, (speed, name) in zip(axes, panels, strict=False):
            _panel(ax, own, speed)
            ax.set(title=name, xlabel="time spent per simulated second [ms]")
        axes[0].set_ylabel("error of the button's centre, rms [mm]")
        legend_below(figure, *axes[0].get_legend_handles_labels(), most=4 if len(panels) > 1 else 2)
        set_title(figure, title)
    return figure


def _panel(ax: Axes, rows: Sequence[AccuracyRow], speed: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    for k, name in enumerate(dict.fromkeys(r.integrator for r in rows)):
        some = [r for r in rows if r.integrator == name and np.isfinite(getattr(r, speed))]
        times = [1e3 / getattr(r, speed) for r in some]
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        look: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 4.5}
        look["linestyle"] = "-" if k < len(COLOURS) else "--"
        ax.plot(times, [r.position_rms_mm for r in some], label=name, **look)
        for r, t in zip(some, times, strict=True):
            if not name.startswith(("diffrax", "quasi")):
                at = {"xytext": (3, 3), "textcoords": "offset points", "fontsize": TINY, "color": colour}
                ax.annotate(f"{r.step_ms:g}", (t, r.position_rms_mm), **at)
    best, words = front(rows, speed), "front of best settings (numbers: step in ms)"
    wide: dict[str, Any] = {"color": "black", "alpha": 0.18, "linewidth": 7, "solid_capstyle": "round", "zorder": 0}
    ax.plot([1e3 / getattr(r, speed) for r in best], [r.position_rms_mm for r in best], label=words, **wide)
    ax.set(xscale="log", yscale="log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())


def write_rows(rows: Sequence[AccuracyRow], folder: Path) -> Path:
    """Writes accuracy.csv, also with the rows so far in case a later one fails; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(path := folder / "accuracy.csv", to_csv(columns(rows)))
    return path


def write(found: AccuracyMeasured, folder: Path, title: str, about: dict[str, Any]) -> list[Path]:
    """Writes accuracy.nc, accuracy.csv, accuracy.md and a figure for each contact model; returns the paths."""
    table = write_rows(found.rows, folder)
    paths = netcdf, _, markdown = [table.with_suffix(".nc"), table, table.with_suffix(".md")]
    save_dataset(to_dataset(columns(found.rows), "setting", about), netcdf)
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
