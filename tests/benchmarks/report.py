"""The rows as a table at the terminal, as Markdown for the documentation, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pftwin.base.errors import InputError
from tests.benchmarks.row import Row

if TYPE_CHECKING:
    from rich.table import Table

SCHEMA = 1
HEADINGS = ("what", "measured", "target", "", "how")


def figure(value: float) -> str:
    """Three digits, thousands separated."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _cells(row: Row) -> tuple[str, str, str, str, str]:
    target = "" if row.target is None else f"{row.sense} {figure(row.target)}"
    verdict = {None: "", True: "met", False: "not met"}[row.passed]
    return row.what, f"{figure(row.value)} {row.unit}", target, verdict, row.note


def table(rows: Sequence[Row], title: str = "pftwin benchmarks") -> Table:
    """For the terminal."""
    from rich.table import Table

    out = Table(title=title, title_justify="left")
    for heading in HEADINGS:
        out.add_column(heading, justify="right" if heading in ("measured", "target") else "left")
    last = None
    for row in rows:
        if last not in (None, row.topic):
            out.add_section()
        last = row.topic
        what, measured, target, verdict, note = _cells(row)
        colour = {None: "", True: "[green]", False: "[red]"}[row.passed]
        out.add_row(what, measured, target, f"{colour}{verdict}", f"[dim]{note}")
    return out


def markdown(rows: Sequence[Row], machine: dict[str, Any]) -> str:
    """For docs/benchmarks.md."""
    m = machine
    lines = [
        f"{m['cpu']}, {m['cores']} cores, {m['dtype']}, jax {m['jax']}, {m['date'][:10]}.",
        "",
        "| what | measured | target | | how |",
        "|---|---:|---:|---|---|",
    ]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def to_json(rows: Sequence[Row], machine: dict[str, Any]) -> str:
    """All that was measured."""
    return json.dumps({"schema": SCHEMA, "machine": machine, "rows": [r.to_json() for r in rows]}, indent=2) + "\n"


def from_json(path: Path) -> tuple[list[Row], dict[str, Any]]:
    """Rows and machine from a file of `to_json`'s.

    Raises:
        InputError: no such file, or not a benchmark's.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["schema"] != SCHEMA:
            raise InputError(f"found {data['schema']!r}", where=f"{path}: schema", expected=str(SCHEMA))
        return [Row.from_json(r) for r in data["rows"]], data["machine"]
    except OSError as err:
        raise InputError(f"cannot be read: {err.strerror}", where=str(path), remedy="check the path") from err
    except (ValueError, KeyError, TypeError) as err:
        raise InputError(
            f"not a benchmark's JSON ({type(err).__name__})",
            where=str(path),
            remedy="write one with the same command and --out FILE.json",
        ) from err
