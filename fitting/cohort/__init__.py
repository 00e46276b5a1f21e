"""Many patients: fits and treatments of each, in units that survive a kill.

from fitting.cohort import read_cohort, run_cohort
report = run_cohort(read_cohort("cohort.toml"), "results", resume=True)
"""

from __future__ import annotations

from fitting.cohort.description import Cohort, Patient, read_cohort
from fitting.cohort.run import run_cohort

__all__ = ["Cohort", "Patient", "read_cohort", "run_cohort"]
