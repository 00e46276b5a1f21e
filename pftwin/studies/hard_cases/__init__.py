"""Scenes that are hard to simulate, and the test matrix that runs them all: `pftwin hard-cases`."""

from __future__ import annotations

from pftwin.studies.hard_cases.case import INTEGRATORS, HardCase, case_named, catalogue, method_named
from pftwin.studies.hard_cases.contacts import CONTACTS
from pftwin.studies.hard_cases.matrix import DTYPES, Selection, run_matrix
from pftwin.studies.hard_cases.table import results
from pftwin.studies.hard_cases.verdict import Cell

__all__ = [
    "CONTACTS",
    "DTYPES",
    "INTEGRATORS",
    "Cell",
    "HardCase",
    "Selection",
    "case_named",
    "catalogue",
    "method_named",
    "results",
    "run_matrix",
]
