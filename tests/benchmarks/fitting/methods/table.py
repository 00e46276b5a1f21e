"""The comparison as rows with targets, and as a table in Markdown and CSV: medians and ranges over seeds."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tests.benchmarks.fitting.methods.comparison import Comparison
from tests.benchmarks.fitting.methods.entrants import ENTRANTS
from tests.benchmarks.fitting.methods.meter import Course
from tests.benchmarks.row import Row

TOPIC = "methods"
OURS = "least_squares"
LABELS = {e.name: e.label for e in ENTRANTS}
CLOSE = 1.01  # objective of a run that found the best known one, as a multiple of it


class Spread(NamedTuple):
    """Median and range over seeds; infinite where runs found nothing."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float] | np.ndarray) -> Spread:
        """Of numbers, one per seed."""
        a = np.asarray(values, dtype=float)
        return Spread(*(float(x) for x in (np.median(a), a.min(), a.max())))

    def text(self) -> str:
        """As it stands in the table."""
        return f"{_short(self.median)} ({_short(self.low)} to {_short(self.high)})"


# Columns of the table, by their key in a row's details.
COLUMNS = {
    "excess_evaluations_mm": "above the best known, equal evaluations [mm]",
    "error_evaluations_percent": "error of the springs, equal evaluations [%]",
    "excess_time_mm": "above the best known, equal time [mm]",
    "error_time_percent": "error of the springs, equal time [%]",
    "evaluations": "evaluations to its end",
    "cpu_s": "processor time to its end [s]",
    "wall_s": "time to its end [s]",
}


def rows_of(c: Comparison) -> list[Row]:
    """Where our default stands among all, then one row per method with its courses."""
    return [_place(c, 0, "evaluations"), _place(c, 1, "time"), *(_row(c, name) for name in c.courses)]


def _place(c: Comparison, k: int, what: str) -> Row:
    medians = {name: float(np.median(fine[:, k])) for name, fine in c.fine.items()}
    order = sorted(medians, key=lambda name: medians[name])
    place = float(1 + sum(value < medians[OURS] for value in medians.values()))
    note = "in order: " + "; ".join(f"{LABELS[n]} {_short(1e3 * (medians[n] - c.best))} mm" for n in order)
    return Row(TOPIC, f"place of our least squares on equal {what}", place, f"of {len(order)}", 1.0, "at most", note)


def _row(c: Comparison, name: str) -> Row:
    summary, close = summary_of(c, name), int(np.sum(c.fine[name][:, 1] <= CLOSE * c.best))
    ends = sorted({course.stopped for course in c.courses[name]})
    return Row(
        TOPIC,
        f"{LABELS[name]}: above the best known on equal evaluations",
        summary["excess_evaluations_mm"].median,
        "mm",
        note=f"on equal time {_short(summary['excess_time_mm'].median)} mm; ended: {' / '.join(ends)}",
        details={
            "method": name,
            "budget": list(c.budget),
            "summary": {key: list(spread) for key, spread in summary.items()},
            "close": close,
            "best_known_m": c.best,
            "best_seen_m": min(b.value for runs in c.courses.values() for r in runs for b in r.bests),
            "courses": [course.to_dict() for course in c.courses[name]],
        },
    )


def summary_of(c: Comparison, name: str) -> dict[str, Spread]:
    """Of one method over its seeds, by the keys of `COLUMNS`."""
    courses, excess = c.courses[name], 1e3 * (c.fine[name] - c.best)
    at = [[r.at_evaluations(c.budget.evaluations), r.at_time(c.budget.seconds)] for r in courses]
    errors = [[np.inf if best is None else _error(c, best.theta) for best in pair] for pair in at]
    columns = (
        excess[:, 0],
        [e[0] for e in errors],
        excess[:, 1],
        [e[1] for e in errors],
        [course.evaluations for course in courses],
        [course.cpu for course in courses],
        [course.wall for course in courses],
    )
    return {key: Spread.of(values) for key, values in zip(COLUMNS, columns, strict=True)}


def _error(c: Comparison, theta: Sequence[float]) -> float:
    """Root mean square over the parameters of their relative deviation from the true ones [%]."""
    return 100 * float(np.sqrt(np.mean((np.array(theta) / c.true - 1) ** 2)))


def targets(rows: Sequence[Row]) -> list[Row]:
    """The rows that are not a single method's: those have a table of their own."""
    return [r for r in rows if "courses" not in r.details]


def courses_of(rows: Sequence[Row]) -> dict[str, list[Course]]:
    """By method, from rows that were measured or read."""
    return {
        r.details["method"]: [Course.from_dict(d) for d in r.details["courses"]]
        for r in rows
        if r.topic == TOPIC and "courses" in r.details
    }


def markdown(rows: Sequence[Row]) -> str:
    """The table: median (range) over seeds; empty where the methods were not compared."""
    compared = [r for r in rows if r.topic == TOPIC and "courses" in r.details]
    if not compared:
        return ""
    headings = ("method", *COLUMNS.values(), "seeds within 1 % of the best known, equal time")
    lines = ["| " + " | ".join(headings) + " |", "|---" + "|---:" * (len(headings) - 1) + "|"]
    for row in compared:
        d = row.details
        cells = [Spread(*d["summary"][key]).text() for key in COLUMNS]
        lines.append("| " + " | ".join([LABELS[d["method"]], *cells, f"{d['close']} of {len(d['courses'])}"]) + " |")
    return "\n".join(lines) + "\n"


def comma_list(rows: Sequence[Row]) -> str:
    """The same table for programs: median, least and largest of each column."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    parts = ("median", "least", "largest")
    writer.writerow(["method", *(f"{key}_{part}" for key in COLUMNS for part in parts), "seeds_close", "seeds"])
    for row in rows:
        if row.topic != TOPIC or "courses" not in row.details:
            continue
        d = row.details
        numbers = [f"{x:.9g}" for key in COLUMNS for x in d["summary"][key]]
        writer.writerow([d["method"], *numbers, d["close"], len(d["courses"])])
    return out.getvalue()


def _short(x: float) -> str:
    return f"{x:,.0f}" if abs(x) >= 100 else f"{x:.3g}"
