"""Fits of case 2 as it was measured, by a plant that differs from the twin, and case 1 predicted from them.

The study itself is `fitting.demo.paper_study`; here its figures stand beside the paper's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.row import Row

if TYPE_CHECKING:
    from fitting.demo.paper_study import PaperStudy, Run

MEAN_DISTANCE = 2.6  # of the treated case's predicted path from the measured one [mm]


def rows(quick: bool) -> list[Row]:
    """Errors of the springs by all fits, and what is predicted of the treated case."""
    from fitting.demo.paper_study import FITS, PAPER, PATHOLOGY, TREATMENT, paper_study

    study = paper_study(starts=4, simulations=1000) if quick else paper_study()
    out = []
    for fit in FITS:
        estimate, errors = study.fits[fit], study.errors(fit, study.nominal)
        for i, name in enumerate(estimate.names[: estimate.asked]):
            low, high = 100 * (estimate.intervals[i] / study.nominal[i] - 1)
            covers = "contains" if low <= 0 <= high else "excludes"
            note = (
                f"{errors[i]:+.1f} %, 95 % interval {low:+.1f} to {high:+.1f} %, which {covers} the nominal "
                f"value; {study.errors(fit, study.line)[i]:+.1f} % from the straight line nearest to the plant's spring"
            )
            what = f"{name}, fit {fit}: error on the mismatched plant"
            error = abs(float(errors[i]))
            out.append(Row("plant", what, error, "%", PAPER.errors[name], "at most", note))
    out.append(_objectives(study))
    for fit in FITS:
        treated, untreated = study.runs[fit][TREATMENT], study.runs[fit][PATHOLOGY]
        distance, paper = float(treated.validation.mean_distance), PAPER.table_2[TREATMENT]["mean_distance"]
        what = f"case {TREATMENT} predicted from the fit of case {PATHOLOGY}, fit {fit}: mean distance"
        out.append(Row("plant", what, distance, "mm", MEAN_DISTANCE, "at most", f"paper {paper} mm"))
        right = [run.as_measured for run in (untreated, treated)]
        note = "; ".join(f"case {run.case}: {run.predicted.describe()}" for run in (untreated, treated))
        what = f"dislocation of case {PATHOLOGY} and tracking of case {TREATMENT}, fit {fit}: right"
        out.append(Row("plant", what, float(sum(right)), "of 2", 2.0, "at least", note))
    return out


def _objectives(study: PaperStudy) -> Row:
    """Whether the search by the paper's objective came closer than the straight lines nearest to the plant's springs:
    what else the twin lacks (the plant's smooth trochlea, friction, attachments) lets other springs do that."""
    from fitting.demo.paper_study import NOMINAL, PAPERS, PATHOLOGY, simulated, with_springs
    from pftwin import rig

    lines = simulated(PATHOLOGY, "straight lines", with_springs(rig.case(PATHOLOGY), study.line))
    found, nominal = (paper_objective(study.runs[springs][PATHOLOGY]) for springs in (PAPERS, NOMINAL))
    what = f"sum of the errors in X, Y and Z in case {PATHOLOGY}, fit paper"
    note = f"the target is that of the straight lines; nominal springs {nominal:.3g} mm"
    return Row("plant", what, found, "mm", paper_objective(lines), "at most", note)


def paper_objective(run: Run) -> float:
    """The paper's objective: the sum of the root mean square errors in X, Y and Z [mm]."""
    return float(sum(getattr(run.validation, axis) for axis in "xyz"))
