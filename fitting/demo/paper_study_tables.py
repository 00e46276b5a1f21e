"""Tables, sentences and files of the study of the paper's section 2.6."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.demo.cases import write_csv
from fitting.demo.paper_study import (
    CASES,
    FITS,
    LEARNED,
    NOMINAL,
    PAPER,
    PAPERS,
    PATHOLOGY,
    TREATMENT,
    PaperStudy,
)
from pftwin.base.quantities import as_read
from pftwin.dynamics.status import status_facts
from pftwin.rig.geometry import MISPLACED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPRINGS = {
    PAPERS: "fitted, paper's objective",
    "positions": "fitted by simulations",
    "force": "fitted by simulations, and one force",
    NOMINAL: "nominal",
}


def table_2(study: PaperStudy) -> Iterator[dict[str, Any]]:
    """Errors of the fitted springs, the fit's time with compiling, and both cases' errors against the measurements.

    A row has its name ("row") and "unit"; "case2_by_paper" and the like for all cases and fits; "case2_published" and
    "case1_published". Values that do not exist are None.
    """
    fitted = {fit: study.errors(fit, study.nominal) for fit in FITS}
    for i, name in enumerate(study.fits[PAPERS].names):  # the paper's fit has springs alone
        errors = {(PATHOLOGY, fit): float(fitted[fit][i]) for fit in FITS}
        yield _row(f"{name} error of nominal", "%", errors, {PATHOLOGY: PAPER.errors[name]})
    seconds = {(PATHOLOGY, fit): study.fits[fit].seconds for fit in FITS}
    yield _row("time of the fit, with compiling", "s", seconds, {PATHOLOGY: PAPER.seconds})
    rows = {(n, fit): study.runs[fit][n].validation.to_rows() for n in CASES for fit in FITS}
    for i, row in enumerate(rows[PATHOLOGY, PAPERS]):
        values = {at: column[i].value for at, column in rows.items()}
        yield _row(row.label, row.unit, values, {n: PAPER.table_2[n].get(row.key) for n in CASES})


def _row(label: str, unit: str, values: dict[tuple[int, str], Any], published: dict[int, Any]) -> dict[str, Any]:
    row = {"row": label, "unit": unit}
    for n in CASES:
        row |= {f"case{n}_by_{fit}": values.get((n, fit)) for fit in FITS}
        row[f"case{n}_published"] = published.get(n)
    return row


def spring_rows(study: PaperStudy, fit: str) -> Iterator[dict[str, Any]]:
    """K1, L1, K2, L2 of one fit, in the units shown, with the nominal values and the nearest straight lines.

    "low" and "high" are the ends of the 95 % interval, and "covered" states which of the two it contains; errors are in
    percent, "error" of the nominal value, "paper_error" without its sign and only for the paper's fit.
    """
    found, line = study.fits[fit], study.line
    errors, errors_of_line = study.errors(fit, study.nominal), study.errors(fit, line)
    for i, name in enumerate(found.names[: found.asked]):
        scale, unit = as_read(found.units[i])
        low, high = found.intervals[i]
        truths = {"nominal": found.nominal[i], "line": line[i]}
        numbers = {**truths, "fitted": found.values[i], "low": low, "high": high}
        yield {
            "name": name,
            "unit": unit,
            **{what: scale * float(value) for what, value in numbers.items()},
            "error": float(errors[i]),
            "error_of_line": float(errors_of_line[i]),
            "paper_error": PAPER.errors[name] if fit == PAPERS else None,
            "covered": " and ".join(w for w, value in truths.items() if low <= value <= high) or "neither",
        }


def outcome_rows(study: PaperStudy) -> Iterator[dict[str, Any]]:
    """Per case, whether the patella dislocates: as measured, with the springs of all fits, and with the nominal ones.

    "as_measured" is None for the measurement itself.
    """
    for n in CASES:
        measured = study.runs[PAPERS][n].measured.describe()
        yield {"case": n, "springs": "measured", "text": measured, "as_measured": None}
        for springs in (*FITS, NOMINAL):
            run, who = study.runs[springs][n], SPRINGS[springs]
            yield {"case": n, "springs": who, "text": run.predicted.describe(), "as_measured": run.as_measured}


def notes(study: PaperStudy) -> Iterator[str]:
    """What the errors mean, one paragraph each."""
    more = zip(study.fits[PAPERS].names, 100 * (study.line / study.nominal - 1), strict=True)
    off = " and ".join(f"{line.misfit:.2f} N" for line in study.lines.values())
    yield (
        "What the errors mean: against the nominal values, as the paper counts them. But the springs of the plant that "
        "makes the measurements stiffen, so a twin with straight ones need not find the nominal values: over the "
        f"forces recorded in case {PATHOLOGY} the straight lines nearest to the plant's springs (off by {off} rms) "
        f"have {', '.join(f'{name} {percent:+.1f} %' for name, percent in more)} against nominal. Slack lengths shift "
        f"too, since the plant's attachments are misplaced by {1e3 * MISPLACED:.1f} mm (standard deviation of each "
        "coordinate)."
    )
    for fit in LEARNED:
        found = study.fits[fit]
        used = " and ".join(found.channels)
        yield (
            f"Friction, attachments, damping and springs that stiffen fitted as nuisance, by {found.starts:,} "
            f"simulated knees, on the spline surface ({used}): {found.sentence()}."
        )
    for fit, found in study.fits.items():
        stopped = fit not in LEARNED and found.reason != "converged"
        at_bounds = [name for name in found.at_bounds if name not in found.auxiliary]
        if stopped or at_bounds:
            bounds = f"; at a bound: {', '.join(at_bounds)}" if at_bounds else ""
            yield f"The fit '{SPRINGS[fit]}' ended: {found.reason}{bounds}."


def facts(study: PaperStudy) -> dict[str, Any]:
    """Plain values, for JSON."""
    return {
        "label": study.fits[PAPERS].source,
        "synthetic": study.fits[PAPERS].synthetic,
        "pathology": PATHOLOGY,
        "treatment": TREATMENT,
        "table2": list(table_2(study)),
        "springs": {fit: list(spring_rows(study, fit)) for fit in FITS},
        "straight_lines": {name: line._asdict() for name, line in study.lines.items()},
        "runs": {s: {n: status_facts(run.result.flags) for n, run in runs.items()} for s, runs in study.runs.items()},
        "outcomes": list(outcome_rows(study)),
        "published_outcomes": PAPER.outcomes,
        "notes": list(notes(study)),
        "fits": {fit: found.to_dict() for fit, found in study.fits.items()},
    }


def save(study: PaperStudy, folder: Path) -> list[Path]:
    """Writes table2.csv, springs.csv, fit.json (the paper's), fit_positions.json, fit_force.json, two figures.

    Raises OutputError if the folder is missing or cannot be written to.
    """
    from pftwin.results.plots import save_figure

    springs = [{"fit": fit, **row} for fit in FITS for row in spring_rows(study, fit)]
    written = [write_csv(folder / "table2.csv", list(table_2(study))), write_csv(folder / "springs.csv", springs)]
    for fit, found in study.fits.items():
        written.append(found.save(folder / ("fit.json" if fit == PAPERS else f"fit_{fit}.json")))
    for n, name in {PATHOLOGY: "pathology_fitted", TREATMENT: "treatment_predicted"}.items():
        written += save_figure(_figure(study, n), folder / name)
    return written


def _figure(study: PaperStudy, case: int) -> Figure:
    """A case as measured, and simulated with fitted and nominal springs."""
    from pftwin import rig
    from pftwin.results.plots import case_figure

    results = {SPRINGS[s]: study.runs[s][case].result for s in (*FITS, NOMINAL)}
    what = {
        PATHOLOGY: "pathology, fitted to its motion",
        TREATMENT: f"treatment, predicted with what was fitted to case {PATHOLOGY}",
    }
    return case_figure(results, rig.measured(case), f"Case {case} of the virtual rig: {what[case]}")
