"""The matrix as tables: for the terminal and for docs/hard_cases.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from importlib.resources import files

from pftwin.base.sheet import Sheet
from pftwin.studies.hard_cases.case import HardCase
from pftwin.studies.hard_cases.pieces import KeptPiece, runs
from pftwin.studies.hard_cases.verdict import Cell

OUTCOMES = ("pass", "fail", "refused")
LONGEST_REASON = 160  # characters


def counts(cells: Iterable[Cell]) -> Counter[str]:
    """How many cells passed, failed and were refused."""
    return Counter(c.outcome for c in cells)


def named(cases: Sequence[HardCase]) -> Sheet:
    """The cases, and what is hard about them."""
    return Sheet("hard cases", ("case", "what is hard"), tuple((c.name, c.about) for c in cases))


def summary(cells: Sequence[Cell]) -> Sheet:
    """Rows of contact, integrator and float type with their counts."""
    rows = []
    for key in dict.fromkeys((c.contact, c.integrator, c.dtype) for c in cells):
        found = counts(c for c in cells if (c.contact, c.integrator, c.dtype) == key)
        rows.append((*key, *(str(found[o]) for o in OUTCOMES)))
    return Sheet("hard cases", ("contact", "integrator", "float type", *OUTCOMES), tuple(rows))


def by_case(cells: Sequence[Cell]) -> Sheet:
    """Rows of cases, columns of integrators: in each the outcomes over contacts and float types."""
    integrators, rows = tuple(dict.fromkeys(c.integrator for c in cells)), []
    for case in dict.fromkeys(c.case for c in cells):
        found = [counts(c for c in cells if (c.case, c.integrator) == (case, i)) for i in integrators]
        rows.append((case, *(", ".join(f"{n[o]} {o}" for o in OUTCOMES if n[o]) or "-" for n in found)))
    return Sheet("by case", ("case", *integrators), tuple(rows))


def _failing(cells: Sequence[Cell]) -> list[str]:
    """Names of the cases that fail somewhere, each once."""
    return list(dict.fromkeys(c.case for c in cells if c.outcome == "fail"))


def outcomes(cells: Sequence[Cell]) -> Sheet:
    """Rows of contact, integrator, float type, outcome and the cases that have it."""
    groups: dict[tuple[str, str, str, str], list[str]] = {}
    for c in cells:
        groups.setdefault((c.contact, c.integrator, c.dtype, c.outcome), []).append(c.case)
    headings = ("contact", "integrator", "float type", "outcome", "cases")
    return Sheet("every cell", headings, tuple((*k, ", ".join(g)) for k, g in groups.items()))


def reasons(cells: Sequence[Cell], outcome: str) -> Sheet:
    """Rows of case, where, and why, for one outcome; contacts and float types of one case and reason share a row."""
    groups: dict[tuple[str, str], list[Cell]] = {}
    for c in cells:
        if c.outcome == outcome:
            groups.setdefault((c.case, c.integrator), []).append(c)
    rows = []
    for (case, integrator), group in groups.items():
        where: dict[str, list[str]] = {}
        for c in group:
            where.setdefault(c.contact, []).append(c.dtype.removeprefix("float"))
        places = ", ".join(f"{contact} ({'/'.join(bits)})" for contact, bits in where.items())
        rows.append((case, integrator, places, _short(group[0].reason)))
    title = "what fails" if outcome == "fail" else f"what is {outcome}"
    return Sheet(title, ("case", "integrator", "contacts", "why (of the first)"), tuple(rows))


def markdown(cells: Sequence[Cell], cases: Sequence[HardCase], pieces: Sequence[KeptPiece]) -> str:
    """The page docs/hard_cases.md, from the pieces that were run."""
    found, m = counts(cells), pieces[-1].machine
    by_name = {c.name: c for c in cases}
    known = [by_name[name] for name in _failing(cells) if name in by_name and by_name[name].unmended]
    lists = {topic: _list(c for c in cases if c.topic == topic) for topic in dict.fromkeys(c.topic for c in cases)}
    page = files("pftwin.studies.hard_cases").joinpath("page.md").read_text(encoding="utf-8")
    return page.format(
        size=f"{len(cases)} cases, {len(cells)} cells: {', '.join(f'{found[o]} {o}' for o in OUTCOMES)}",
        minutes=sum(p.seconds for p in pieces) / 60,
        machine=f"{m['cpu']}, {m['cores']} cores, jax {m['jax']}",
        failing=reasons(cells, "fail").grid() if found["fail"] else "Nothing.",
        known="\n".join(f"- **{c.name}**: {c.unmended}" for c in known),
        summary=summary(cells).grid(),
        by_case=by_case(cells).grid(),
        refused=reasons(cells, "refused").grid(),
        outcomes=outcomes(cells).grid(),
        cases="\n\n".join(f"### {topic[0].upper()}{topic[1:]}\n{text}" for topic, text in lists.items()),
        runs=runs(pieces).grid(),
    )


def _list(cases: Iterable[HardCase]) -> str:
    return "\n".join(f"- **{c.name}**: {c.about}" for c in cases)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_REASON else text[: LONGEST_REASON - 3].rstrip() + "..."
