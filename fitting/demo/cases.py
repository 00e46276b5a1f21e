"""The main job on the embedded rig: four cases, three polynomials (in full: meshes and a spline as well), against the
rig's (synthetic) measurements.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from pftwin.results.metrics import Validation, ValidationRow
    from pftwin.results.result import Result

CASES = (1, 2, 3, 4)
CONTACTS = ("P2", "P4", "P5")
FURTHER = ("CM", "FM", "spline")  # the paper's two meshes, and what replaces them
STEP = 1e-3  # the paper's [s]


def run_demo(folder: Path, console: Console, *, full: bool = False) -> dict[str, Any]:
    """Simulates, compares, draws and saves; returns what it printed as plain values.

    Args:
        folder: what is written goes there.
        console: what is printed goes there.
        full: the paper's whole Table 1, its meshes included, and the spline.

    Writes to `folder`: case1_P5.nc and its like, case1.png and .svg, table1.csv.
    """
    from rich.console import Console
    from rich.progress import Progress

    from pftwin import rig
    from pftwin.dynamics.simulate import simulate
    from pftwin.results.metrics import mean_of, validate
    from pftwin.results.plots import case_figure, save_figure
    from pftwin.rig.cases import contact_fit

    folder.mkdir(parents=True, exist_ok=True)
    results: dict[int, dict[str, Result]] = {n: {} for n in CASES}
    contacts = (*FURTHER, *CONTACTS) if full else CONTACTS
    validations: dict[str, list[Validation]] = {c: [] for c in contacts}
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("simulating", total=len(CASES) * len(contacts))
        for contact in contacts:
            for n in CASES:
                progress.update(task, description=f"case {n}, {contact}")
                result = simulate(rig.case(n, contact), dt=STEP)
                results[n][contact] = result
                validations[contact].append(validate(result, rig.measured(n)))
                result.save(folder / f"case{n}_{contact}.nc")
                progress.advance(task)
    means = {c: mean_of(v) for c, v in validations.items()}
    for some in (FURTHER, CONTACTS) if full else (CONTACTS,):
        console.print(_table({c: means[c] for c in some}))
    outcomes = _outcomes(results)
    console.print(_outcome_table(outcomes))
    pictures = []
    for n in CASES:
        drawn = case_figure(results[n], rig.measured(n), f"Case {n} of the virtual rig")
        pictures += [str(p) for p in save_figure(drawn, folder / f"case{n}")]
    fits = {c: contact_fit(c) for c in (*CONTACTS, "spline")}
    _write_csv(means, folder / "table1.csv")
    console.print(f"results, figures and table1.csv are in {folder}", markup=False, highlight=False)
    return {
        "label": rig.measured(1).source,
        "synthetic": True,
        "settings": {"integrator": "linear_implicit", "dt_s": STEP},
        "surface_fits": {
            c: {"r_squared": f.r_squared, "rms_m": f.rms, "max_error_m": f.max_error} for c, f in fits.items()
        },
        "table1": {c: v.to_dict() for c, v in means.items()},
        "per_case": {c: [v.to_dict() for v in validations[c]] for c in contacts},
        "outcomes": outcomes,
        "figures": pictures,
    }


def narrow_table(title: str) -> Table:
    """An empty table that has room for many columns in a terminal 80 wide."""
    from rich import box
    from rich.table import Table

    return Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))


def _table(means: dict[str, Validation]) -> Table:
    """The paper's Table 1, ours and theirs side by side where they have it."""
    from pftwin.results.metrics import PAPER_TABLE_1

    table = narrow_table(
        "Means over the four cases: pftwin against the virtual rig's SYNTHETIC measurements,\n"
        "beside Table 1 of Michaud et al. 2024 (their rig, their measurements)"
    )
    table.add_column("", no_wrap=True)
    for contact in means:
        table.add_column(f"pftwin\n{contact}", justify="right", no_wrap=True)
        if contact in PAPER_TABLE_1:
            table.add_column(f"paper\n{contact}", justify="right", style="dim", no_wrap=True)
    for rows in _rows(means):
        cells = []
        for contact, row in zip(means, rows, strict=True):
            cells += [_number(row.value), *([_number(row.paper)] if contact in PAPER_TABLE_1 else [])]
        table.add_row(f"{rows[0].label}, {rows[0].unit}", *cells)
    return table


def _rows(means: dict[str, Validation]) -> list[tuple[ValidationRow, ...]]:
    """The rows of all contacts, the paper's figures in them where it has any."""
    from pftwin.results.metrics import PAPER_TABLE_1

    return list(zip(*(v.to_rows(c if c in PAPER_TABLE_1 else None) for c, v in means.items()), strict=True))


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1g}" if abs(value) < 0.1 else f"{value:.3g}"


def _outcomes(results: dict[int, dict[str, Result]]) -> list[dict[str, Any]]:
    """Per case and polynomial: whether and when the patella dislocates, and whether it comes back."""
    rows = []
    for n, by_contact in results.items():
        for contact, result in by_contact.items():
            tracking = result.dislocations()
            if tracking is None:
                continue
            found = {"text": tracking.describe(), "re_engaged": tracking.re_engaged}
            rows.append({"case": n, "contact": contact, "dislocates": bool(tracking.events), **found})
    return rows


def _outcome_table(outcomes: list[dict[str, Any]]) -> Table:
    table = narrow_table(
        "Tracking (the paper: 1 and 4 track; 2 and 3 dislocate, but not with P2;\n2 does not re-engage)"
    )
    for name in ("case", "contact", "outcome"):
        table.add_column(name)
    for row in outcomes:
        table.add_row(str(row["case"]), row["contact"], row["text"])
    return table


def _write_csv(means: dict[str, Validation], path: Path) -> None:
    from pftwin.base.output import written_whole

    lines = ["row,unit," + ",".join(f"{c},paper_{c}" for c in means)]
    for rows in _rows(means):
        cells = [f"{x:.6g}" if x is not None else "" for row in rows for x in (row.value, row.paper)]
        lines.append(",".join([f'"{rows[0].label}"', rows[0].unit, *cells]))
    with written_whole(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
