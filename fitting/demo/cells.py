"""Cells of the demo's tables: numbers for people, and files of them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pftwin.base.output import written_whole


def number_cell(value: float | None, *, signed: bool = False) -> str:
    """A number with as many digits as tell something; "-" where there is none."""
    if value is None:
        return "-"
    digits = ".1g" if abs(value) < 0.1 else ".3g" if abs(value) < 1000 else ".0f"
    return f"{value:{'+' if signed else ''}{digits}}"


def write_csv(path: Path, headings: Sequence[str], lines: Iterable[Sequence[Any]]) -> Path:
    """Writes a table, whole or not at all: numbers with six digits, and empty cells for None.

    Raises:
        OutputError: it cannot be written.
    """
    with written_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(headings)
        for line in lines:
            writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in line])
    return path
