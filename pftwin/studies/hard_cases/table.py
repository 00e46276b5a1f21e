"""Tables of the matrix, its partial results as JSON, the page docs/hard_cases.md, and results of single cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import jax

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.text_files import read_json
from pftwin.results.result import Result
from pftwin.studies.hard_cases.batch import BatchRuns, built_scene, member, steps_of
from pftwin.studies.hard_cases.case import HardCase, method_named
from pftwin.studies.hard_cases.knee import RATE
from pftwin.studies.hard_cases.matrix import EVERYTHING, Prepared
from pftwin.studies.hard_cases.verdict import Cell

OUTCOMES = ("pass", "fail", "refused")
LONGEST_REASON = 160  # characters


def counts(cells: Iterable[Cell]) -> Counter[str]:
    """Counts the cells that passed, failed and were refused."""
    return Counter(c.outcome for c in cells)


def named_cases(cases: Sequence[HardCase]) -> Sheet:
    """Returns a table of the cases and their difficulties."""
    return Sheet("hard cases", ("case", "what is hard"), tuple((c.name, c.about) for c in cases))


def _grouped(cells: Iterable[Cell], *fields: str) -> dict[tuple[str, ...], list[Cell]]:
    """Cells grouped by the values of these fields."""
    groups: dict[tuple[str, ...], list[Cell]] = {}
    for c in cells:
        groups.setdefault(tuple(getattr(c, name) for name in fields), []).append(c)
    return groups


def summary(cells: Sequence[Cell]) -> Sheet:
    """Returns a table of outcome counts by contact, integrator and float type."""
    groups = _grouped(cells, "contact", "integrator", "dtype")
    rows = tuple((*key, *(str(counts(group)[o]) for o in OUTCOMES)) for key, group in groups.items())
    return Sheet("hard cases", ("contact", "integrator", "float type", *OUTCOMES), rows)


def by_case(cells: Sequence[Cell]) -> Sheet:
    """Returns a table of outcome counts, over contacts and float types, by case and integrator."""
    integrators, rows = tuple(dict.fromkeys(c.integrator for c in cells)), []
    for (case,), group in _grouped(cells, "case").items():
        found = [counts(c for c in group if c.integrator == i) for i in integrators]
        rows.append((case, *(", ".join(f"{n[o]} {o}" for o in OUTCOMES if n[o]) or "-" for n in found)))
    return Sheet("by case", ("case", *integrators), tuple(rows))


def outcomes(cells: Sequence[Cell]) -> Sheet:
    """Returns a table of the cases by contact, integrator, float type and outcome."""
    groups = _grouped(cells, "contact", "integrator", "dtype", "outcome")
    rows = tuple((*key, ", ".join(c.case for c in group)) for key, group in groups.items())
    return Sheet("every cell", ("contact", "integrator", "float type", "outcome", "cases"), rows)


def reasons(cells: Sequence[Cell], outcome: str) -> Sheet:
    """Returns a table of the reasons for an outcome; contacts and float types of a case and integrator share a row."""
    rows = []
    for key, group in _grouped((c for c in cells if c.outcome == outcome), "case", "integrator").items():
        where = _grouped(group, "contact").items()
        bits = (f"{contact} ({'/'.join(c.dtype.removeprefix('float') for c in found)})" for (contact,), found in where)
        why = group[0].reason
        why = why if len(why) <= LONGEST_REASON else why[: LONGEST_REASON - 3].rstrip() + "..."
        rows.append((*key, ", ".join(bits), why))
    title = "what fails" if outcome == "fail" else f"what is {outcome}"
    return Sheet(title, ("case", "integrator", "contacts", "why (of the first)"), tuple(rows))


def markdown(cells: Sequence[Cell], cases: Sequence[HardCase], pieces: Sequence[MatrixPiece]) -> str:
    """Returns the page docs/hard_cases.md from the partial results."""
    found, m = counts(cells), pieces[-1].machine
    why = {c.name: c.unmended or c.limit for c in cases}
    failing = dict.fromkeys(c.case for c in cells if c.outcome == "fail")
    known: dict[str, list[str]] = {}
    for name in failing:
        if text := why.get(name):
            known.setdefault(text, []).append(name)
    topics: dict[str, list[str]] = {}
    for c in cases:
        topics.setdefault(c.topic, []).append(f"- **{c.name}**: {c.about}")
    page = files("pftwin.studies.hard_cases").joinpath("page.md").read_text(encoding="utf-8")
    return page.format(
        size=f"{len(cases)} cases, {len(cells)} cells: {', '.join(f'{found[o]} {o}' for o in OUTCOMES)}",
        minutes=sum(p.seconds for p in pieces) / 60,
        machine=f"{m['cpu']}, {m['cores']} cores, jax {m['jax']}",
        failing=reasons(cells, "fail").grid() if found["fail"] else "Nothing.",
        known="\n".join(f"- **{', '.join(names)}**: {text}" for text, names in known.items()),
        summary=summary(cells).grid(),
        by_case=by_case(cells).grid(),
        refused=reasons(cells, "refused").grid(),
        outcomes=outcomes(cells).grid(),
        cases="\n\n".join("\n".join([f"### {t[0].upper()}{t[1:]}", *lines]) for t, lines in topics.items()),
        runs=runs(pieces).grid(),
    )


_EXPECTED = "what pftwin hard-cases --json has written"


class MatrixPiece(NamedTuple):
    """A partial result: the cells of one run."""

    rows: tuple[Cell, ...]
    seconds: float  # run time, including compilation
    machine: dict[str, Any]  # from `pftwin.base.runtime.describe`, with the date
    quick: bool  # whether derivatives and batches were omitted
    truths: bool = False  # whether runs were compared with converged ones

    def as_dict(self) -> dict[str, Any]:
        """Returns plain values that can be written as JSON."""
        return {**self._asdict(), "rows": [c._asdict() for c in self.rows]}


def read_piece(path: Path) -> MatrixPiece:
    """Reads a partial result written by `pftwin hard-cases --json`; InputError for a missing or different file."""
    found = read_json(path, expected=_EXPECTED)
    try:
        rows = tuple(Cell(**one) for one in found["rows"])
        words = float(found["seconds"]), dict(found["machine"]), bool(found["quick"]), bool(found.get("truths"))
        return MatrixPiece(rows, *words)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"no piece of the matrix: {error}", where=path, expected=_EXPECTED) from error


def read_pieces(path: Path) -> list[MatrixPiece]:
    """Reads a partial result, or all *.json files of a folder from oldest to newest; raises as `read_piece` does."""
    if not path.is_dir():
        return [read_piece(path)]
    found = [read_piece(one) for one in sorted(path.glob("*.json"))]
    if not found:
        raise InputError("no piece in it", where=str(path), expected=_EXPECTED)
    return sorted(found, key=lambda piece: str(piece.machine["date"]))


def merged_pieces(pieces: Sequence[MatrixPiece], order: Sequence[tuple[str, ...]]) -> list[Cell]:
    """Merges pieces, each cell from the last that has it; `order`: names of cases, contacts, integrators, dtypes."""
    latest = {cell[:4]: cell for piece in pieces for cell in piece.rows}
    ranks = [{name: k for k, name in enumerate(names)} for names in order]

    def rank(cell: Cell) -> tuple[int, ...]:
        case, contact, integrator, dtype = (r.get(x, len(r)) for r, x in zip(ranks, cell[:4], strict=True))
        return contact, integrator, dtype, case

    return sorted(latest.values(), key=rank)


_CHECKED = {  # by whether derivatives and batches were omitted, and whether there were converged runs
    (False, True): "everything",
    (False, False): "everything but converged runs",
    (True, True): "the run, beside a converged one",
    (True, False): "the run alone",
}


def runs(pieces: Sequence[MatrixPiece]) -> Sheet:
    """Returns a table of the partial results: contents, date and run time."""
    rows = []
    for piece in pieces:
        cases, *names = (dict.fromkeys(cell[k] for cell in piece.rows) for k in range(4))
        checked = _CHECKED[piece.quick, piece.truths]
        when, minutes = str(piece.machine["date"])[:16], f"{piece.seconds / 60:.1f}"
        rows.append((when, minutes, *map(", ".join, names), str(len(cases)), checked))
    headings = ("date", "minutes", "contacts", "integrators", "float types", "cases", "checked")
    return Sheet("what was run", headings, tuple(rows))


def results(
    cases: Sequence[HardCase], contact: str = "P5", integrator: str = "linear_implicit"
) -> dict[str, Result | InputError]:
    """Returns the result or the error of each case with a kind of contact, in float64, run as in `run_matrix`.

    Unlike `pftwin.simulate`, it can release a patella that is not in equilibrium if the case requires it.
    """
    method, prepared, found = method_named(integrator), Prepared(cases, contact, EVERYTHING), {}
    with jax.enable_x64(True):
        for batch, starts in prepared.stacks("float64"):
            runs = BatchRuns(batch, starts.chosen, method.integrator, True)
            for k, case in enumerate(batch.cases):
                n = steps_of(case, method)
                one = runs.tried(k, n).run
                found[case.name] = Result.build(
                    built_scene(case, contact),
                    member(starts.chosen, k),
                    one.observation,
                    one.ledger,
                    relaxed=False,
                    settings={"integrator": integrator, "dt_s": 1 / RATE / n, "substeps": n},
                    timing={},
                )
        found |= prepared.batches("float64")[1]
    return {c.name: found[c.name] for c in cases if c.name in found}
