"""The rows as a dataset and as tables: everything, the front of best settings, and a few recommendations."""

from __future__ import annotations

import csv as comma_separated
import os
from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pftwin.errors import InputError
from pftwin.mocap.text_files import read_lines
from pftwin.result_dataset import plain_attribute
from pftwin.studies.accuracy.measure import Row

if TYPE_CHECKING:
    from xarray import Dataset

LEVELS = (0.2, 0.1, 0.05, 0.01, 0.001)  # rms errors that settings are recommended for [mm]
ALIKE = 0.9  # ratio of two speeds that measuring again may turn around
ABOUT = {
    "order": ("1", "order that the integrator declares"),
    "step_ms": ("ms", "step"),
    "position_rms_mm": ("mm", "button's centre against the converged run of the same contact, rms over the frames"),
    "position_max_mm": ("mm", "the same, largest"),
    "tilt_rms_deg": ("deg", "tilt against the converged run, rms"),
    "force_rms_n": ("N", "contact force against the converged run, rms"),
    "dislocation_ms": ("ms", "time of the first dislocation, less the converged run's"),
    "measured_mm": ("mm", "mean distance of the button's centre from the measurements"),
    "real_time": ("1", "one run with all results, in times faster than real time"),
    "real_time_batch": ("1", "64 variants side by side, in times faster than real time"),
    "compile_s": ("s", "tracing and compiling one run"),
    "gradient": ("1", "a run with four forward derivatives, in plain runs"),
}
_NEEDED = ("step_ms", "position_rms_mm", "real_time")  # columns without which a row says nothing


class Advice(NamedTuple):
    """The fastest setting within an error."""

    level_mm: float
    row: Row | None  # None: no setting that was measured is that accurate
    best_batch: Row | None


def dataset(rows: Sequence[Row], attributes: dict[str, Any]) -> Dataset:
    """One dimension, `setting`; units and long names on every variable."""
    from xarray import Dataset

    values = {f.name: np.array([getattr(r, f.name) for r in rows]) for f in fields(Row)}
    data = {
        name: ("setting", v, dict(zip(("units", "long_name"), ABOUT[name], strict=True)) if name in ABOUT else {})
        for name, v in values.items()
    }
    return Dataset(data, attrs={k: plain_attribute(v) for k, v in attributes.items()})


def csv(rows: Sequence[Row]) -> str:
    """Comma-separated, units in the names."""
    names = [f.name for f in fields(Row)]
    lines = [",".join(names)]
    for row in rows:
        cells = row.to_dict()
        lines.append(",".join(f"{c:.6g}" if isinstance(c, float) else f'"{c}"' for c in (cells[n] for n in names)))
    return "\n".join(lines) + "\n"


def read_csv(path: str | os.PathLike[str]) -> list[Row]:
    """Rows that `csv` wrote, of this version or of one that knew fewer columns: what it lacks is NaN.

    Lines that start with # and columns that a row does not have are passed over.

    Raises:
        InputError: no such file, or one without the columns that make a row.
    """
    where, texts = str(path), ("contact", "integrator", "dtype", "status")
    lines, _ = read_lines(path)
    found = []
    for number, cells in enumerate(comma_separated.DictReader(x for x in lines if not x.startswith("#")), start=1):
        if missing := [n for n in (*texts, "order", *_NEEDED) if not cells.get(n)]:
            raise InputError(f"row {number} has no {missing[0]}", where=where, expected="a table of pftwin accuracy")
        try:
            values = {f.name: float(cells.get(f.name) or "nan") for f in fields(Row) if f.name not in texts}
        except ValueError as error:
            raise InputError(f"row {number}: {error}", where=where, expected="numbers") from error
        found.append(Row(**{n: cells[n] for n in texts}, **{**values, "order": int(values["order"])}))
    return found


def front(rows: Iterable[Row], speed: str = "real_time") -> list[Row]:
    """Settings that no other is both faster and more accurate than, the fastest first."""
    usable = [r for r in rows if np.isfinite(r.position_rms_mm) and np.isfinite(getattr(r, speed))]
    best, found = np.inf, []
    for row in sorted(usable, key=lambda r: (-getattr(r, speed), r.position_rms_mm)):
        if row.position_rms_mm < best:
            best = row.position_rms_mm
            found.append(row)
    return found


def recommended(rows: Sequence[Row], levels: Sequence[float] = LEVELS) -> list[Advice]:
    """For each level of error the fastest setting, alone and in a batch; of equally fast ones that in double precision,
    and the most accurate.
    """

    def fastest(level: float, speed: str) -> Row | None:
        within = [r for r in rows if r.position_rms_mm <= level and np.isfinite(getattr(r, speed))]
        enough = ALIKE * max((getattr(r, speed) for r in within), default=0.0)
        fast = [r for r in within if getattr(r, speed) >= enough]
        return min(fast, key=lambda r: (r.dtype == "float32", r.position_rms_mm), default=None)

    return [Advice(level, fastest(level, "real_time"), fastest(level, "real_time_batch")) for level in levels]


def advice_markdown(rows: Sequence[Row]) -> str:
    """The recommendations."""
    lines = [
        "| error, rms | one run | x real time | error, max | contact force, rms | 64 side by side | x real time |",
        "|---|---|---|---|---|---|---|",
    ]
    for level, one, many in recommended(rows):
        alone = ("none measured", *"---") if one is None else (described(one), short(one.real_time), *_errors(one))
        beside = ("-", "-") if many is None else (described(many), short(many.real_time_batch))
        lines.append(f"| {level:g} mm | {' | '.join((*alone, *beside))} |")
    return "\n".join(lines) + "\n"


def rows_markdown(rows: Sequence[Row]) -> str:
    """Everything."""
    lines = [
        "| contact | integrator | float | step, ms | position rms (max), mm | tilt, deg | force, N | dislocation, ms"
        " | from measurements, mm | x real time | 64 side by side | compile, s | derivatives | status |",
        "|" + "---|" * 14,
    ]
    for r in rows:
        cells = (
            r.contact,
            r.integrator,
            r.dtype,
            f"{r.step_ms:g}",
            f"{short(r.position_rms_mm)} ({short(r.position_max_mm)})",
            short(r.tilt_rms_deg),
            short(r.force_rms_n),
            short(r.dislocation_ms),
            short(r.measured_mm),
            short(r.real_time),
            short(r.real_time_batch),
            short(r.compile_s),
            short(r.gradient),
            r.status,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def described(row: Row) -> str:
    """A setting in words."""
    single = "" if row.dtype == "float64" else ", float32"
    return f"{row.contact}, {row.integrator}, {row.step_ms:g} ms{single}"


def _errors(row: Row) -> tuple[str, str]:
    """Largest of the position, rms of the contact's force."""
    return f"{short(row.position_max_mm)} mm", f"{short(row.force_rms_n)} N"


def short(value: float) -> str:
    """Two digits, or whole above a hundred; a dash for what is not known."""
    if not np.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"
