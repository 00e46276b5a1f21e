"""The matrix as tables: for the terminal and for docs/hard_cases.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from pftwin.studies.hard_cases.case import Case
from pftwin.studies.hard_cases.limits import LIMITS
from pftwin.studies.hard_cases.pieces import Piece, runs
from pftwin.studies.hard_cases.verdict import Cell
from pftwin.studies.tables import Sheet

OUTCOMES = ("pass", "fail", "refused")
LONGEST_REASON = 160  # characters


def counts(cells: Iterable[Cell]) -> Counter[str]:
    """How many cells passed, failed and were refused."""
    return Counter(c.outcome for c in cells)


def named(cases: Sequence[Case]) -> Sheet:
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


def markdown(cells: Sequence[Cell], cases: Sequence[Case], pieces: Sequence[Piece]) -> str:
    """The page docs/hard_cases.md, from the pieces that were run."""
    found, m = counts(cells), pieces[-1].machine
    minutes = sum(p.seconds for p in pieces) / 60
    topics = dict.fromkeys(c.topic for c in cases)
    by_name = {c.name: c for c in cases}
    known = [by_name[name] for name in _failing(cells) if name in by_name and by_name[name].unmended]
    parts = [
        _INTRODUCTION,
        f"{len(cases)} cases, {len(cells)} cells: {', '.join(f'{found[o]} {o}' for o in OUTCOMES)}. Made by "
        f"`pftwin hard-cases` with `--json`, piece by piece, and then `--from` and `--markdown`, in {minutes:.0f}"
        f" minutes with compiling, other work going on: {m['cpu']}, {m['cores']} cores, jax {m['jax']}.",
        "## What fails, and why",
        reasons(cells, "fail").grid() if found["fail"] else "Nothing.",
        "\n".join(f"- **{c.name}**: {c.unmended}" for c in known),
        "## By contact, integrator and float type",
        summary(cells).grid(),
        "## By case\nOver all kinds of contact and float types.",
        by_case(cells).grid(),
        "## What is refused\nIn words, before anything is computed, or by flags of the frames that say so.",
        reasons(cells, "refused").grid(),
        "### Limits of kinds of contact\nA run that goes beyond them says so by its flags, and is refused.",
        "\n".join(f"- **{name}**: {limit.why}" for name, limit in LIMITS.items()),
        "## Every cell",
        outcomes(cells).grid(),
        "## The cases",
        *(f"### {t[0].upper()}{t[1:]}\n" + _list(c for c in cases if c.topic == t) for t in topics),
        "## What was run, and when\n" + _NOT_RUN,
        runs(pieces).grid(),
    ]
    return "\n\n".join(parts) + "\n"


_INTRODUCTION = """# Hard cases

Scenes that have broken simulators of contact before (`pftwin.studies.hard_cases`), with the kinds of contact,
integrators and float types of the tables below, and no others ([what was run](#what-was-run-and-when)). All scenes are
made up.

**Pass**: everything is finite; flags of the
frames are right (contact and depth by an exhaustive search that shares no code with the simulator's); the quaternion
has length 1; energy less the work of guided bodies never rises; no indentation stores more than there was; there is no
force at a distance and no missed contact; a symmetric scene stays symmetric. Where the table says that everything was
looked at: derivatives by a tendon's stiffness and slack length, the surface's height and the contact's stiffness are
finite, and where the motion is smooth those of finite differences; and on patches the run depends neither on its place
in a batch nor on what runs beside it, NaN included. **Refused**: the input, or the run's own flags, say in words that
there is no answer, before any number that is not finite. **Fail**: all else. Tolerances are in
`pftwin/studies/hard_cases/look.py` and `derivatives.py`."""


_NOT_RUN = """Cells that are in no row have not been run. Of cells run twice the later counts; each was judged by the
code of its date. Some are left out by design (`pftwin/studies/hard_cases/integrators.py`): `ali3p` and diffrax's
solvers run on P5 in float64 alone, `ali3p` in cases of at most 1,000 steps and without derivatives; batches of `ali3p`,
`newmark` and `quasi_static`, and on meshes of all, are not looked at: they compile for minutes. Nor are derivatives
on contours but for the linearly implicit steps, and `quasi_static`'s by volume: they take tens of minutes each.

`quasi_static` has no inertia, so nothing falls, bounces or swings: what is let go snaps to where it can rest, and says
so. Cases about bounces, restitution and free flight stay in the table with what then still has to hold: finite
numbers, right contact and depth, right flags (a snap is told, and not wrong), the same rest, and stored energy less
work that never rises; energy of the rates does not count. No equilibrium at all is refused, not passed."""


def _list(cases: Iterable[Case]) -> str:
    return "\n".join(f"- **{c.name}**: {c.about}" for c in cases)


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_REASON else text[: LONGEST_REASON - 3].rstrip() + "..."
