"""`pftwin demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from fitting.demo.cases import number_cell
from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.cli.exit_codes import exit_flagged, report_written_on_interrupt
from pftwin.cli.terminal import (
    JsonOption,
    check_folder,
    check_outputs,
    present,
    progress,
    show,
    spinner,
    start_computing,
    write_json,
)

if TYPE_CHECKING:
    from fitting.demo.paper_study import PaperStudy


def demo(
    *,
    folder: Annotated[Path, Option("--out", metavar="DIR", help="Folder of the results.")] = Path("demo"),
    full: Annotated[bool, Option("--full", help="Also simulate the paper's meshes CM and FM, and the spline.")] = False,
    knee: Annotated[
        bool,
        Option("--knee", help="Simulate a natural knee before and after a tuberosity transfer, instead of the rig."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Simulate the virtual rig's cases, fit its springs, predict a treatment; compare with measurements and the paper.

    With --knee: simulate a natural knee before and after a tuberosity transfer, and write both as a page and a film.

    Example: `pftwin demo --out demo`
    """
    if knee and full:
        raise InputError("given with --full, which applies to the rig", where="--knee", expected="one of the two")
    check_folder(folder)
    check_outputs(json)
    start_computing()
    if knee:
        from fitting.demo.natural_knee import run_knee

        with report_written_on_interrupt(folder), progress("simulating") as shown:
            outcome, parts = run_knee(folder, shown)
        present(outcome, *parts, json=json)
        if outcome["doubts"]:
            exit_flagged("; ".join(outcome["doubts"]))
        return
    from fitting.demo.cases import run_demo

    with report_written_on_interrupt(folder):
        with progress("simulating") as shown:
            outcome, parts = run_demo(folder, shown, full=full)
        show(*parts, json=json)
        study = _paper_study(folder, json)
    figures = [*outcome["figures"], *study.pop("figures")]
    write_json({**outcome, "figures": figures, "section_2_6": study}, json)


def _paper_study(folder: Path, json: str | None) -> dict[str, Any]:
    """Repeats the paper's section 2.6: fits springs to case 2, simulates cases 2 and 1; returns values for JSON."""
    from fitting.demo.paper_study import CASES, FITS, STEP, paper_study
    from fitting.demo.paper_study_tables import facts, notes, save

    with progress("fitting") as shown:
        study = paper_study(dt=STEP, progress=lambda done, of, what: shown(done, of, f"{int(done)} of {of}", what))
    with spinner("drawing"):
        files = save(study, folder)
    where = f"written to {folder}: {', '.join(p.name for p in files)}"
    sheets = (*(_table_2(study, n) for n in CASES), *(_springs(study, fit) for fit in FITS), _outcomes(study))
    show(*sheets, *notes(study), where, json=json)
    return {**facts(study), "figures": [str(p) for p in files if p.suffix in (".png", ".svg")]}


def _table_2(study: PaperStudy, case: int) -> Sheet:
    from fitting.demo.paper_study import FITS, PATHOLOGY
    from fitting.demo.paper_study_tables import table_2

    what = "pathology, fitted" if case == PATHOLOGY else f"treatment, predicted with springs of case {PATHOLOGY}"
    title = (
        f"Case {case} ({what}): pftwin against SYNTHETIC\n"
        "measurements of the virtual rig. A: springs by the paper's objective, on P5;\n"
        "B: by simulations, with nuisance parameters, on the spline; C: B and one force;\n"
        "paper: section 3 and Table 2 of Michaud et al. 2024 (on their rig; errors of\n"
        "springs without signs)"
    )
    rows = []
    for row in table_2(study):
        own = [row[f"case{case}_by_{fit}"] for fit in FITS]
        if any(value is not None for value in own):
            cells = [number_cell(v, signed=row["unit"] == "%") for v in own]
            rows.append((f"{row['row']}, {row['unit']}", *cells, number_cell(row[f"case{case}_published"])))
    return Sheet(title, ("", "A", "B", "C", "paper"), tuple(rows), words=(0,))


def _springs(study: PaperStudy, fit: str) -> Sheet:
    from fitting.demo.paper_study_tables import SPRINGS, spring_rows

    title = f"Springs, {SPRINGS[fit]}, to SYNTHETIC measurements of case 2"
    about = "line: straight line nearest to the plant's; off: against nominal, as in the paper"
    headings = ["", "nominal", "line", "fitted", "95 % interval", "which\ncovers", "off,\n%", "off\nline,\n%"]
    headings += ["paper\noff,\n%"] if fit == "paper" else []
    rows = []
    for row in spring_rows(study, fit):
        cells = [f"{row[what]:.4g}" for what in ("nominal", "line", "fitted")]
        covered = "both" if " and " in row["covered"] else row["covered"]
        cells += [f"{row['low']:.4g} to {row['high']:.4g}", covered]
        cells += [f"{row['error']:+.1f}", f"{row['error_of_line']:+.1f}"]
        cells += [] if row["paper_error"] is None else [f"{row['paper_error']:.0f}"]
        rows.append((f"{row['name']}, {row['unit']}", *cells))
    return Sheet(f"{title}\n({about})", tuple(headings), tuple(rows), words=(0,))


def _outcomes(study: PaperStudy) -> Sheet:
    from fitting.demo.paper_study import PAPER
    from fitting.demo.paper_study_tables import outcome_rows

    published = "; ".join(f"case {n} {text}" for n, text in PAPER.outcomes.items())
    title = (
        "Outcome of pathology and treatment within the recordings, to 49 deg of flexion"
        f"\n(the paper, measured and predicted: {published})"
    )
    agrees = {None: "", True: "yes", False: "NO"}
    rows = tuple((str(r["case"]), r["springs"], r["text"], agrees[r["as_measured"]]) for r in outcome_rows(study))
    return Sheet(title, ("case", "springs", "outcome", "as measured"), rows)
