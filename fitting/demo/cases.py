"""Demonstration: the rig's four cases with three polynomials (in full also meshes and a spline), compared with its
(synthetic) measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pftwin.base.sheet import Column, Sheet, to_csv

if TYPE_CHECKING:
    from pftwin.results.metrics import Validation, ValidationRow
    from pftwin.results.result import Result

CASES = (1, 2, 3, 4)
CONTACTS = ("P2", "P4", "P5")
FURTHER = ("CM", "FM", "spline")  # the paper's two meshes, and the spline that replaces them
STEP = 1e-3  # as in the paper [s]
PAPER_R_SQUARED = {"P2": 91.54, "P4": 99.36, "P5": 99.71}  # [%] Michaud et al. 2024, section 2.4.2
SHARED = (
    "The plant that makes these measurements has mechanics of its own, but shares with the twin the contact stiffness,"
    " the masses, the nominal springs and what both assume: an error that is in both shows in neither table."
)


def run_demo(
    folder: Path, progress: Callable[..., None], *, full: bool = False
) -> tuple[dict[str, Any], list[Sheet | str]]:
    """Simulates, compares, draws and saves; returns the results as plain values, and as tables and lines.

    Args:
        folder: folder of the output: case1_P5.nc and the like, case1.png and .svg, table1.csv.
        progress: called with the number of simulations done and of all, and the next one (`what=`).
        full: whether to make the paper's whole Table 1, including its meshes, and the spline.
    """
    from pftwin import rig
    from pftwin.dynamics.simulate import simulate
    from pftwin.dynamics.status import status_facts
    from pftwin.results.metrics import mean_of, validate
    from pftwin.results.plots import case_figure, save_figure
    from pftwin.rig.contacts import contact_fit

    folder.mkdir(parents=True, exist_ok=True)
    results: dict[int, dict[str, Result]] = {n: {} for n in CASES}
    contacts = (*FURTHER, *CONTACTS) if full else CONTACTS
    validations: dict[str, list[Validation]] = {c: [] for c in contacts}
    runs = [(contact, n) for contact in contacts for n in CASES]
    for done, (contact, n) in enumerate(runs):
        progress(done, len(runs), what=f"case {n}, {contact}")
        result = simulate(rig.case(n, contact), dt=STEP)
        results[n][contact] = result
        validations[contact].append(validate(result, rig.measured(n)))
        result.save(folder / f"case{n}_{contact}.nc")
    means = {c: mean_of(v) for c, v in validations.items()}
    outcomes = _outcomes(results)
    pictures = []
    for n in CASES:
        drawn = case_figure(results[n], rig.measured(n), f"Case {n} of the virtual rig")
        pictures += [str(p) for p in save_figure(drawn, folder / f"case{n}")]
    fits = {c: contact_fit(c) for c in (*CONTACTS, "spline")}
    parts: list[Sheet | str] = [
        *(_table({c: means[c] for c in some}) for some in ((FURTHER, CONTACTS) if full else (CONTACTS,))),
        _outcome_table(outcomes),
        _fit_note({c: fits[c].r_squared for c in CONTACTS}),
        SHARED,
        f"results, figures and table1.csv are in {folder}",
    ]
    lines = [{"row": rows[0].label, "unit": rows[0].unit} for rows in _rows(means)]
    for line, rows in zip(lines, _rows(means), strict=True):
        line |= {
            k: v for c, row in zip(means, rows, strict=True) for k, v in ((c, row.value), (f"paper_{c}", row.paper))
        }
    write_csv(folder / "table1.csv", lines)
    facts = {
        "label": rig.measured(1).source,
        "synthetic": True,
        "settings": {"integrator": results[CASES[0]][CONTACTS[0]].settings["integrator"], "dt_s": STEP},
        "surface_fits": {
            c: {"r_squared": f.r_squared, "rms_m": f.rms, "max_error_m": f.max_error} for c, f in fits.items()
        },
        "table1": {c: v.to_dict() for c, v in means.items()},
        "per_case": {
            c: [{**v.to_dict(), **status_facts(results[n][c].flags)} for n, v in zip(CASES, found, strict=True)]
            for c, found in validations.items()
        },
        "outcomes": outcomes,
        "notes": [_fit_note({c: fits[c].r_squared for c in CONTACTS}), SHARED],
        "figures": pictures,
    }
    return facts, parts


def _table(means: dict[str, Validation]) -> Sheet:
    """The paper's Table 1, with the paper's values beside ours where it reports them."""
    from pftwin.results.metrics import PAPER_TABLE_1

    title = (
        "Means over the four cases: pftwin against the virtual rig's SYNTHETIC measurements,\n"
        "beside Table 1 of Michaud et al. 2024 (their rig, their measurements)"
    )
    sources = {c: ("pftwin", "paper") if c in PAPER_TABLE_1 else ("pftwin",) for c in means}
    headings = ("", *(f"{source}\n{contact}" for contact, found in sources.items() for source in found))
    lines = []
    for rows in _rows(means):
        cells = [
            number_cell(value)
            for found, row in zip(sources.values(), rows, strict=True)
            for value in (row.value, row.paper)[: len(found)]
        ]
        lines.append((f"{rows[0].label}, {rows[0].unit}", *cells))
    return Sheet(title, headings, tuple(lines), words=(0,))


def _rows(means: dict[str, Validation]) -> list[tuple[ValidationRow, ...]]:
    """The rows of all contacts, with the paper's values where it reports any."""
    from pftwin.results.metrics import PAPER_TABLE_1

    return list(zip(*(v.to_rows(c if c in PAPER_TABLE_1 else None) for c, v in means.items()), strict=True))


def _outcomes(results: dict[int, dict[str, Result]]) -> list[dict[str, Any]]:
    """Per case and polynomial: whether the patella dislocates, and re-engages within the recording."""
    rows = []
    for n, by_contact in results.items():
        for contact, result in by_contact.items():
            if result.surface is None:
                continue
            outcome = result.dislocations()
            found = {"dislocates": None, "re_engaged": None}  # of an INVALID motion
            if outcome is not None:
                found = {"dislocates": bool(outcome.events), "re_engaged": outcome.re_engaged}
            rows.append({"case": n, "contact": contact, "text": result.tracking, **found})
    return rows


def _outcome_table(outcomes: list[dict[str, Any]]) -> Sheet:
    title = (
        "Tracking within the recordings, which end at some 50 deg of flexion, dislocated\n"
        "buttons still sliding outwards (the paper: 1 and 4 track; 2 and 3 dislocate,\n"
        "but not with P2; in 2 the patella wedges superiorly)"
    )
    rows = tuple((str(row["case"]), row["contact"], row["text"]) for row in outcomes)
    return Sheet(title, ("case", "contact", "outcome"), rows)


def _fit_note(r_squared: dict[str, float]) -> str:
    ours = ", ".join(f"{c} {100 * value:.2f} % (paper {PAPER_R_SQUARED[c]})" for c, value in r_squared.items())
    return (
        f"R^2 of the fits to the femoral component: {ours}. The virtual component was tuned to these figures of the"
        " paper's: that they are near each other shows nothing."
    )


def number_cell(value: float | None, *, signed: bool = False) -> str:
    """A number with as many digits as are meaningful; "-" for None."""
    if value is None:
        return "-"
    digits = ".1g" if abs(value) < 0.1 else ".3g" if abs(value) < 1000 else ".0f"
    return f"{value:{'+' if signed else ''}{digits}}"


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    """Writes a table, complete or not at all (OutputError), as `to_csv` does."""
    from pftwin.base.text_files import write_text

    write_text(path, to_csv([Column(name, [row[name] for row in rows]) for name in rows[0]]))
    return path
