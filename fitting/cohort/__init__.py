"""Cohorts: fits and treatments of many patients, in units of work that survive a killed process.

from fitting.cohort import read_cohort, run_cohort
report = run_cohort(read_cohort("cohort.toml"), "results", resume=True)
"""

from __future__ import annotations

from fitting.cohort.description import Cohort, Patient, read_cohort
from fitting.cohort.run import run_cohort

__all__ = ["Cohort", "Patient", "read_cohort", "run_cohort"]
