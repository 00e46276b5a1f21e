"""Pieces of the matrix, run at different times: kept as JSON, and put together for one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.studies.hard_cases.verdict import Cell
from pftwin.studies.tables import read_rows

_EXPECTED = "what pftwin hard-cases --json has written"


class KeptPiece(NamedTuple):
    """Cells that were run in one go."""

    rows: tuple[Cell, ...]
    seconds: float  # compiling included
    machine: dict[str, Any]  # as `pftwin.base.machine.describe` has it, date included
    quick: bool  # neither derivatives nor batches side by side

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**self._asdict(), "rows": [c._asdict() for c in self.rows]}


def read_piece(path: Path) -> KeptPiece:
    """A piece that `pftwin hard-cases --json` has written.

    Raises:
        InputError: no such file, or another one's content.
    """
    found, rows = read_rows(path, Cell, _EXPECTED)
    try:
        return KeptPiece(tuple(rows), float(found["seconds"]), dict(found["machine"]), bool(found["quick"]))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"no piece of the matrix: {error}", where=path, expected=_EXPECTED) from error


def read_pieces(path: Path) -> list[KeptPiece]:
    """A piece, or all that lie in a folder as *.json, from the oldest to the newest.

    Raises:
        InputError: no such file, another one's content, or a folder without a piece.
    """
    if not path.is_dir():
        return [read_piece(path)]
    found = [read_piece(one) for one in sorted(path.glob("*.json"))]
    if not found:
        raise InputError("no piece in it", where=str(path), expected=_EXPECTED)
    return sorted(found, key=lambda piece: str(piece.machine["date"]))


def merged(pieces: Sequence[KeptPiece], order: Sequence[tuple[str, ...]]) -> list[Cell]:
    """All cells, each once: of the last piece that has it.

    Args:
        pieces: from the oldest to the newest.
        order: names of cases, contacts, integrators and float types, each in the order in which they are to be shown.
    """
    kept = {cell[:4]: cell for piece in pieces for cell in piece.rows}
    ranks = [{name: k for k, name in enumerate(names)} for names in order]

    def rank(cell: Cell) -> tuple[int, ...]:
        case, contact, integrator, dtype = (r.get(x, len(r)) for r, x in zip(ranks, cell[:4], strict=True))
        return contact, integrator, dtype, case

    return sorted(kept.values(), key=rank)


def runs(pieces: Sequence[KeptPiece]) -> Sheet:
    """Rows of what each piece ran and when."""
    rows = []
    for piece in pieces:
        names = (
            ", ".join(dict.fromkeys(getattr(c, n) for c in piece.rows)) for n in ("contact", "integrator", "dtype")
        )
        cases = str(len({c.case for c in piece.rows}))
        looked = "the run alone" if piece.quick else "everything"
        rows.append((str(piece.machine["date"])[:16], f"{piece.seconds / 60:.1f}", *names, cases, looked))
    headings = ("date", "minutes", "contacts", "integrators", "float types", "cases", "looked at")
    return Sheet("what was run", headings, tuple(rows))
