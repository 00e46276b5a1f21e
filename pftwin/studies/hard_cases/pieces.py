"""Pieces of the matrix, run at different times: kept as JSON, and put together for one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pftwin.errors import InputError
from pftwin.json_files import read_json
from pftwin.studies.hard_cases.verdict import Cell


class Piece(NamedTuple):
    """Cells that were run in one go."""

    cells: tuple[Cell, ...]
    seconds: float  # compiling included
    machine: dict[str, Any]  # as `pftwin.benchmarks.machine.describe` has it, date included
    quick: bool  # neither derivatives nor batches side by side

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**self._asdict(), "cells": [c._asdict() for c in self.cells]}


def read_piece(path: Path) -> Piece:
    """A piece that `pftwin hard-cases --json` has written.

    Raises:
        InputError: no such file, or another one's content.
    """
    where = str(path)
    expected = "a file that pftwin hard-cases --json has written"
    found = read_json(path, expected=expected)
    try:
        cells = tuple(Cell(**c) for c in found["cells"])
        return Piece(cells, float(found["seconds"]), dict(found["machine"]), bool(found["quick"]))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"no cells of the matrix in it: {error}", where=where, expected=expected) from error


def read_pieces(path: Path) -> list[Piece]:
    """A piece, or all that lie in a folder as *.json, from the oldest to the newest.

    Raises:
        InputError: no such file, another one's content, or a folder without a piece.
    """
    if not path.is_dir():
        return [read_piece(path)]
    found = [read_piece(one) for one in sorted(path.glob("*.json"))]
    if not found:
        raise InputError("no piece in it", where=str(path), expected="files that pftwin hard-cases --json has written")
    return sorted(found, key=lambda piece: str(piece.machine["date"]))


def merged(pieces: Sequence[Piece], order: Sequence[tuple[str, ...]]) -> list[Cell]:
    """All cells, each once: of the last piece that has it.

    Args:
        pieces: from the oldest to the newest.
        order: names of cases, contacts, integrators and float types, each in the order in which they are to be shown.
    """
    kept = {cell[:4]: cell for piece in pieces for cell in piece.cells}
    ranks = [{name: k for k, name in enumerate(names)} for names in order]

    def rank(cell: Cell) -> tuple[int, ...]:
        case, contact, integrator, dtype = (r.get(x, len(r)) for r, x in zip(ranks, cell[:4], strict=True))
        return contact, integrator, dtype, case

    return sorted(kept.values(), key=rank)


def runs(pieces: Sequence[Piece]) -> list[list[str]]:
    """Rows of what each piece ran and when, a head first."""
    rows = [["date", "minutes", "contacts", "integrators", "float types", "cases", "looked at"]]
    for piece in pieces:
        names = (
            ", ".join(dict.fromkeys(getattr(c, n) for c in piece.cells)) for n in ("contact", "integrator", "dtype")
        )
        cases = str(len({c.case for c in piece.cells}))
        looked = "the run alone" if piece.quick else "everything"
        rows.append([str(piece.machine["date"])[:16], f"{piece.seconds / 60:.1f}", *names, cases, looked])
    return rows
