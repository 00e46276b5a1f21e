"""The study of the paper's section 2.6 as tables, sentences and files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fitting.demo.cells import write_csv
from fitting.demo.paper_study import (
    CASES,
    FITS,
    LEARNED,
    LINES,
    NOMINAL,
    PAPER,
    PATHOLOGY,
    TREATMENT,
    PaperStudy,
    values_of,
)
from pftwin.base.quantities import as_read
from pftwin.dynamics.status import status_facts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPRINGS = {
    "paper": "fitted, paper's objective",
    "positions": "fitted by simulations",
    "force": "fitted by simulations, and one force",
    NOMINAL: "nominal",
    LINES: "straight lines",
}


class Row(NamedTuple):
    """A row of Table 2. Values are None where there are none."""

    label: str
    unit: str
    values: dict[tuple[int, str], float | None]  # by case and fit
    paper: dict[int, float | None]  # by case


class SpringRow(NamedTuple):
    """A parameter of the springs, in the units shown; errors and shares in percent."""

    name: str
    unit: str
    nominal: float
    line: float  # of the straight line nearest to the plant's spring
    fitted: float
    low: float  # 95 % interval
    high: float
    error: float  # against the nominal value
    error_of_line: float
    paper_error: float | None  # without its sign
    covered: str  # which of both the interval covers


class OutcomeRow(NamedTuple):
    """Whether the patella dislocates in a case."""

    case: int
    springs: str
    text: str
    as_measured: bool | None  # None: the measurement itself


def table_2(study: PaperStudy) -> Iterator[Row]:
    """Errors of the fitted springs, the time of the fit, and both cases' errors against the measurements."""
    none: dict[int, float | None] = dict.fromkeys(CASES)
    fitted = {fit: study.errors(fit) for fit in FITS}
    for i, name in enumerate(study.fits[FITS[0]].names):  # the paper's: springs alone
        errors = {(PATHOLOGY, fit): float(fitted[fit][i]) for fit in FITS}
        yield Row(f"{name} error of nominal", "%", _filled(errors), none | {PATHOLOGY: PAPER.errors[name]})
    seconds = {(PATHOLOGY, fit): study.fits[fit].seconds for fit in FITS}
    yield Row("time of the fit (B, C: with compiling)", "s", _filled(seconds), none | {PATHOLOGY: PAPER.seconds})
    yield Row("compiling before the paper's", "s", _filled({(PATHOLOGY, FITS[0]): study.compiling}), none)
    rows = {(n, fit): study.runs[fit][n].validation.to_rows() for n in CASES for fit in FITS}
    for i, row in enumerate(rows[PATHOLOGY, FITS[0]]):
        values = {at: column[i].value for at, column in rows.items()}
        yield Row(row.label, row.unit, values, {n: PAPER.table_2[n].get(row.key) for n in CASES})


def _filled(values: dict[tuple[int, str], float]) -> dict[tuple[int, str], float | None]:
    return {(n, fit): values.get((n, fit)) for n in CASES for fit in FITS}


def spring_rows(study: PaperStudy, fit: str) -> Iterator[SpringRow]:
    """K1, L1, K2, L2 of one fit beside the nominal values and the straight lines."""
    found, lines = study.fits[fit], values_of(study.nearest)
    errors, errors_of_line = study.errors(fit), study.errors_of_line(fit)
    for i, name in enumerate(found.names[: found.asked]):
        scale, unit = as_read(found.units[i])
        low, high = found.intervals[i]
        truths = {"nominal": found.nominal[i], "line": lines[i]}
        covered = " and ".join(what for what, value in truths.items() if low <= value <= high)
        yield SpringRow(
            name,
            unit,
            nominal=scale * float(found.nominal[i]),
            line=scale * float(lines[i]),
            fitted=scale * float(found.values[i]),
            low=scale * float(low),
            high=scale * float(high),
            error=float(errors[i]),
            error_of_line=float(errors_of_line[i]),
            paper_error=PAPER.errors[name] if fit == "paper" else None,
            covered=covered or "neither",
        )


def outcome_rows(study: PaperStudy) -> Iterator[OutcomeRow]:
    """Per case: as measured, with the springs of all fits, and with the nominal ones."""
    for n in CASES:
        yield OutcomeRow(n, "measured", study.runs[FITS[0]][n].measured.describe(), None)
        for springs in (*FITS, NOMINAL):
            run = study.runs[springs][n]
            yield OutcomeRow(n, SPRINGS[springs], run.predicted.describe(), run.as_measured)


def notes(study: PaperStudy) -> Iterator[str]:
    """What the errors mean, one paragraph each."""
    from pftwin.rig.geometry import MISPLACED

    names = study.fits[FITS[0]].names
    nearest, recorded = (100 * (values_of(v) / study.nominal - 1) for v in (study.nearest, study.recorded))
    off = " and ".join(f"{line.misfit:.2f} N" for line in study.nearest.values())
    yield (
        "What the errors mean: against the nominal values, as the paper counts them. But the springs of the plant that "
        "makes the measurements stiffen, so a twin with straight ones need not find the nominal values: over the "
        f"forces recorded in case {PATHOLOGY} the straight lines nearest to the plant's springs (off by {off} rms) "
        f"have {_shares(names, nearest)} against nominal."
    )
    yield (
        f"Slack lengths shift too since the plant's attachments are misplaced by {1e3 * MISPLACED:.1f} mm (standard "
        "deviation of each coordinate): lines through the recorded forces over the lengths between the twin's "
        f"attachments have {_shares(names, recorded)}."
    )
    sums = {springs: run[PATHOLOGY].objective for springs, run in study.runs.items()}
    listed = ", ".join(f"{value:.1f} mm {SPRINGS[springs]}" for springs, value in sums.items())
    least = (
        " So the search did not miss the straight lines: other springs come closer. What the twin lacks besides "
        "(the plant's smooth trochlea, its friction, its attachments) can do that."
    )
    least = least if sums["paper"] < sums[LINES] else ""
    about = f"Sum of the errors in X, Y and Z in case {PATHOLOGY}, which the paper's fit makes least by springs alone"
    yield f"{about}: {listed}.{least}"
    for fit in LEARNED:
        found = study.fits[fit]
        used = " and ".join(found.channels)
        yield (
            f"Friction, attachments, damping and springs that stiffen fitted besides, by {found.starts:,} simulated "
            f"knees, on the spline surface ({used}): {found.sentence()}."
        )
    for fit, found in study.fits.items():
        stopped = fit not in LEARNED and found.reason != "converged"
        at_bounds = [name for name in found.at_bounds if name not in found.besides]
        if stopped or at_bounds:
            bounds = f"; at a bound: {', '.join(at_bounds)}" if at_bounds else ""
            yield f"The fit '{SPRINGS[fit]}' ended: {found.reason}{bounds}."


def _shares(names: tuple[str, ...], percents: np.ndarray) -> str:
    return ", ".join(f"{n} {p:+.1f} %" for n, p in zip(names, percents, strict=True))


def facts(study: PaperStudy) -> dict[str, Any]:
    """Plain values, for JSON."""
    lines = {"nearest": study.nearest, "recorded": study.recorded}
    return {
        "label": study.fits[FITS[0]].source,
        "synthetic": study.fits[FITS[0]].synthetic,
        "pathology": PATHOLOGY,
        "treatment": TREATMENT,
        "compiling_s": study.compiling,
        "table2": [
            {
                "row": row.label,
                "unit": row.unit,
                **{f"case{n}_by_{fit}": value for (n, fit), value in row.values.items()},
                **{f"case{n}_published": row.paper[n] for n in CASES},
            }
            for row in table_2(study)
        ],
        "springs": {fit: [row._asdict() for row in spring_rows(study, fit)] for fit in FITS},
        "straight_lines": {k: {name: line._asdict() for name, line in v.items()} for k, v in lines.items()},
        "objective_mm": {s: {n: run.objective for n, run in runs.items()} for s, runs in study.runs.items()},
        "runs": {s: {n: status_facts(run.result.flags) for n, run in runs.items()} for s, runs in study.runs.items()},
        "outcomes": [row._asdict() for row in outcome_rows(study)],
        "published_outcomes": PAPER.outcomes,
        "notes": list(notes(study)),
        "fits": {fit: found.to_dict() for fit, found in study.fits.items()},
    }


def save(study: PaperStudy, folder: Path) -> list[Path]:
    """Writes table2.csv, springs.csv, fit.json (the paper's), fit_positions.json, fit_force.json, two figures.

    Raises:
        OutputError: the folder is missing or cannot be written to.
    """
    from pftwin.results.plots import save_figure

    columns = [f"case{n}_{what}" for n in CASES for what in (*(f"by_{f}" for f in FITS), "published")]
    lines = [
        [r.label, r.unit, *(v for n in CASES for v in (*(r.values[n, fit] for fit in FITS), r.paper[n]))]
        for r in table_2(study)
    ]
    springs = [[fit, *row] for fit in FITS for row in spring_rows(study, fit)]
    written = [
        write_csv(folder / "table2.csv", ["row", "unit", *columns], lines),
        write_csv(folder / "springs.csv", ["fit", *SpringRow._fields], springs),
    ]
    for fit, found in study.fits.items():
        written.append(found.save(folder / ("fit.json" if fit == "paper" else f"fit_{fit}.json")))
    for n in CASES:
        name = "pathology_fitted" if n == PATHOLOGY else "treatment_predicted"
        written += save_figure(figure(study, n), folder / name)
    return written


def figure(study: PaperStudy, case: int) -> Figure:
    """A case as measured, and simulated with fitted and with nominal springs."""
    from pftwin import rig
    from pftwin.results.plots import case_figure

    results = {SPRINGS[s]: study.runs[s][case].result for s in (*FITS, NOMINAL)}
    what = "pathology, fitted to its motion" if case == PATHOLOGY else "treatment, predicted"
    title = f"Case {case} of the virtual rig: {what}"
    if case != PATHOLOGY:
        title += f" with what was fitted to case {PATHOLOGY}"
    return case_figure(results, rig.measured(case), title)
