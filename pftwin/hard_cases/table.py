"""The matrix as tables: for the terminal and for docs/hard_cases.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from pftwin.hard_cases.case import Case
from pftwin.hard_cases.verdict import Cell

OUTCOMES = ("pass", "fail", "refused")
LONGEST_REASON = 160  # characters


def counts(cells: Iterable[Cell]) -> Counter[str]:
    """How many cells passed, failed and were refused."""
    return Counter(c.outcome for c in cells)


def summary(cells: Sequence[Cell]) -> list[list[str]]:
    """Rows of contact, integrator and float type with their counts, a head first."""
    rows = [["contact", "integrator", "float type", *OUTCOMES]]
    for key in dict.fromkeys((c.contact, c.integrator, c.dtype) for c in cells):
        found = counts(c for c in cells if (c.contact, c.integrator, c.dtype) == key)
        rows.append([*key, *(str(found[o]) for o in OUTCOMES)])
    return rows


def by_case(cells: Sequence[Cell]) -> list[list[str]]:
    """Rows of cases, columns of integrators: in each the outcomes over contacts and float types."""
    integrators = list(dict.fromkeys(c.integrator for c in cells))
    rows = [["case", *integrators]]
    for case in dict.fromkeys(c.case for c in cells):
        row = [case]
        for integrator in integrators:
            found = counts(c for c in cells if (c.case, c.integrator) == (case, integrator))
            row.append(", ".join(f"{found[o]} {o}" for o in OUTCOMES if found[o]) or "-")
        rows.append(row)
    return rows


def reasons(cells: Sequence[Cell], outcome: str) -> list[list[str]]:
    """Rows of case, where, and why, for one outcome; contacts and float types of one case and reason share a row."""
    groups: dict[tuple[str, str], list[Cell]] = {}
    for c in cells:
        if c.outcome == outcome:
            groups.setdefault((c.case, c.integrator), []).append(c)
    rows = [["case", "integrator", "contacts", "why (of the first)"]]
    for (case, integrator), group in groups.items():
        where: dict[str, list[str]] = {}
        for c in group:
            where.setdefault(c.contact, []).append(c.dtype.removeprefix("float"))
        places = ", ".join(f"{contact} ({'/'.join(bits)})" for contact, bits in where.items())
        rows.append([case, integrator, places, _short(group[0].reason)])
    return rows


def as_dicts(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """For JSON."""
    return [c._asdict() for c in cells]


def markdown(cells: Sequence[Cell], cases: Sequence[Case], machine: dict[str, Any], seconds: float, scope: str) -> str:
    """The page docs/hard_cases.md; `scope` says in a sentence what of the matrix was run."""
    found, m = counts(cells), machine
    topics = dict.fromkeys(c.topic for c in cases)
    parts = [
        _INTRODUCTION,
        f"{len(cases)} cases, {len(cells)} cells: {', '.join(f'{found[o]} {o}' for o in OUTCOMES)}. {scope} Made by "
        f"`pftwin hard-cases --markdown docs/hard_cases.md` in {seconds / 60:.0f} minutes, compiling included, other"
        f" work going on: {m['cpu']}, {m['cores']} cores, jax {m['jax']}, {m['date'][:10]}.",
        "## By contact, integrator and float type",
        _table(summary(cells)),
        "## By case\nOver all kinds of contact and float types.",
        _table(by_case(cells)),
        "## What fails, and why",
        _table(reasons(cells, "fail")) if found["fail"] else "Nothing.",
        "## What is refused\nIn words, before anything is computed, or by flags of the frames that say so.",
        _table(reasons(cells, "refused")),
        "## The cases",
        *(f"### {t[0].upper()}{t[1:]}\n" + _list(c for c in cases if c.topic == t) for t in topics),
    ]
    return "\n\n".join(parts) + "\n"


_INTRODUCTION = """# Hard cases

Scenes that have broken simulators of contact before, each with every kind of contact, integrator and float type,
forward and differentiated (`pftwin.hard_cases`). All scenes are made up. **Pass**: everything is finite; flags of the
frames are right (contact and depth by an exhaustive search that shares no code with the simulator's); the
quaternion has length 1; energy less the work of guided bodies never rises; no indentation stores more than there was;
there is no force at a distance and no missed contact; a symmetric scene stays symmetric; the run does not depend on
its place in a batch nor on what runs beside it, NaN included; derivatives by a tendon's stiffness and slack length,
the surface's height and the contact's stiffness are finite, and where the motion is smooth those of finite
differences. **Refused**: the input, or the run's own flags, say in words that there is no answer, before any number
that is not finite. **Fail**: all else. Tolerances are in `pftwin/hard_cases/look.py` and `derivatives.py`."""


def _table(rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def _list(cases: Iterable[Case]) -> str:
    return "\n".join(f"- **{c.name}**: {c.about}" for c in cases)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_REASON else text[: LONGEST_REASON - 3].rstrip() + "..."
