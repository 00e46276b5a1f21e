"""`pftwin demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.cli.exit_codes import keeping
from pftwin.cli.terminal import JsonOption, check_folder, check_outputs, err, out, start_computing, write_json

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from fitting.demo.paper_study import PaperStudy


def demo(
    *,
    folder: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results.")] = Path("demo"),
    full: Annotated[
        bool, typer.Option("--full", help="The paper's meshes CM and FM, and the spline, as well.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Simulate the virtual rig's cases, fit its springs, predict a treatment; beside measurements and the paper.

    Example: `pftwin demo --out demo`
    """
    check_folder(folder)
    check_outputs(json)
    start_computing()
    from fitting.demo.cases import run_demo

    console = out(json)
    with keeping(folder):
        outcome = run_demo(folder, console, full=full)
        study = _paper_study(folder, console)
    figures = [*outcome["figures"], *study.pop("figures")]
    write_json({**outcome, "figures": figures, "section_2_6": study}, json)


def _paper_study(folder: Path, console: Console) -> dict[str, Any]:
    """The paper's section 2.6: springs fitted to case 2, cases 2 and 1 simulated with them; as plain values."""
    from fitting.demo.paper_study import FITS, STEP, paper_study
    from fitting.demo.paper_study_tables import facts, notes, save

    with err().status("fitting ...") as spinner:
        study = paper_study(dt=STEP, progress=lambda what: spinner.update(f"{what} ..."))
        spinner.update("drawing ...")
        written = save(study, folder)
    for table in (_table_2(study), *(_springs(study, fit) for fit in FITS), _outcomes(study)):
        console.print(table)
    for note in notes(study):
        console.print(note, markup=False, highlight=False)
    console.print(f"written to {folder}: {', '.join(p.name for p in written)}", markup=False, highlight=False)
    return {**facts(study), "figures": [str(p) for p in written if p.suffix in (".png", ".svg")]}


def _table_2(study: PaperStudy) -> Table:
    from fitting.demo.cases import narrow_table
    from fitting.demo.paper_study import CASES, PATHOLOGY
    from fitting.demo.paper_study_tables import table_2

    table = narrow_table(
        "Springs fitted to the motion of case 2 (pathology); cases 2 and 1 (treatment)\n"
        "simulated with them: pftwin against the virtual rig's SYNTHETIC measurements,\n"
        "A: fitted by the paper's objective; B: by likelihood; beside section 3 and\n"
        "Table 2 of Michaud et al. 2024 (their rig; errors of springs without signs)"
    )
    table.add_column("")
    for n in CASES:
        called = "fitted" if n == PATHOLOGY else "predicted"
        for fit in "AB":
            table.add_column(f"case {n}\n{called}\n{fit}", justify="right", no_wrap=True)
        table.add_column(f"case {n}\n\npaper", justify="right", style="dim", no_wrap=True)
    for row in table_2(study):
        signed = row.unit == "%"
        cells = [
            _number(v, signed=signed and v is not row.paper[n])
            for n in CASES
            for v in (*(value for (case, _), value in row.values.items() if case == n), row.paper[n])
        ]
        table.add_row(f"{row.label}, {row.unit}", *cells)
    return table


def _springs(study: PaperStudy, fit: str) -> Table:
    from fitting.demo.cases import narrow_table
    from fitting.demo.paper_study_tables import SPRINGS, spring_rows

    title = f"Springs, {SPRINGS[fit]}, to SYNTHETIC measurements of case 2"
    about = "line: the straight one nearest to the plant's; off: against nominal, as the paper counts"
    table = narrow_table(f"{title}\n({about})")
    table.add_column("", no_wrap=True)
    for name in ("nominal", "line", "fitted", "95 % interval", "which\ncovers", "off,\n%", "off\nline,\n%"):
        table.add_column(name, justify="right", no_wrap=True)
    if fit == "paper":
        table.add_column("paper\noff,\n%", justify="right", style="dim", no_wrap=True)
    for row in spring_rows(study, fit):
        cells = [f"{v:.4g}" for v in (row.nominal, row.line, row.fitted)]
        covered = "both" if " and " in row.covered else row.covered
        cells += [f"{row.low:.4g} to {row.high:.4g}", covered, f"{row.error:+.1f}", f"{row.error_of_line:+.1f}"]
        cells += [] if row.paper_error is None else [f"{row.paper_error:.0f}"]
        table.add_row(f"{row.name}, {row.unit}", *cells)
    return table


def _outcomes(study: PaperStudy) -> Table:
    from fitting.demo.cases import narrow_table
    from fitting.demo.paper_study import PAPER
    from fitting.demo.paper_study_tables import outcome_rows

    published = "; ".join(f"case {n} {text}" for n, text in PAPER.outcomes.items())
    title = f"Outcome of pathology and treatment\n(the paper, measured and predicted: {published})"
    table = narrow_table(title)
    for name in ("case", "springs", "outcome", "as measured"):
        table.add_column(name)
    for row in outcome_rows(study):
        agrees = "" if row.as_measured is None else "yes" if row.as_measured else "NO"
        table.add_row(str(row.case), row.springs, row.text, agrees)
    return table


def _number(value: float | None, *, signed: bool = False) -> str:
    if value is None:
        return "-"
    digits = ".1g" if abs(value) < 0.1 else ".3g" if abs(value) < 1000 else ".0f"
    return f"{value:{'+' if signed else ''}{digits}}"
