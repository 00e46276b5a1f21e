"""Files of the study of the paper's section 2.6: tables as CSV, estimates as JSON, figures."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.demo.paper_study import CASES, FITS, NOMINAL, PATHOLOGY, PaperStudy
from fitting.demo.paper_study_tables import SPRINGS, SpringRow, spring_rows, table_2
from pftwin.base.output import written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(study: PaperStudy, folder: Path) -> list[Path]:
    """Writes table2.csv, springs.csv, fit.json, fit_likelihood.json, and a figure of each case as PNG and SVG.

    Raises:
        OutputError: the folder is missing or cannot be written to.
    """
    from pftwin.results.plots import save_figure

    headings = [
        "row",
        "unit",
        *(f"case{n}_{what}" for n in CASES for what in (*(f"by_{f}" for f in FITS), "published")),
    ]
    lines = [
        [r.label, r.unit, *(v for n in CASES for v in (*(r.values[n, fit] for fit in FITS), r.paper[n]))]
        for r in table_2(study)
    ]
    springs = [[fit, *row] for fit in FITS for row in spring_rows(study, fit)]
    written = [
        _write_csv(folder / "table2.csv", headings, lines),
        _write_csv(folder / "springs.csv", ["objective", *SpringRow._fields], springs),
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
    what = "pathology, the springs fitted to its motion" if case == PATHOLOGY else "treatment, predicted"
    title = f"Case {case} of the virtual rig: {what}"
    if case != PATHOLOGY:
        title += f" with the springs fitted to case {PATHOLOGY}"
    return case_figure(results, rig.measured(case), title)


def _write_csv(path: Path, headings: list[str], lines: Iterable[list[Any]]) -> Path:
    with written_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(headings)
        for line in lines:
            writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in line])
    return path
