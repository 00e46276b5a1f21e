"""Scenes that are hard to simulate, by name, and the matrix that runs them all: `pftwin hard-cases`."""

from __future__ import annotations

from pftwin.errors import InputError
from pftwin.studies.hard_cases import grooves, meshes, moving, refused, scattered, tendons, touching
from pftwin.studies.hard_cases.case import Case
from pftwin.studies.hard_cases.contacts import CONTACTS
from pftwin.studies.hard_cases.integrators import INTEGRATORS, method_named
from pftwin.studies.hard_cases.matrix import DTYPES, Selection, run_matrix
from pftwin.studies.hard_cases.results import results
from pftwin.studies.hard_cases.verdict import Cell

_TOPICS = (touching, tendons, grooves, moving, scattered, meshes, refused)


def catalogue() -> tuple[Case, ...]:
    """All cases, topic by topic."""
    return tuple(case for topic in _TOPICS for case in topic.CASES)


def case_named(name: str) -> Case:
    """The case of that name.

    Raises:
        InputError: no such case.
    """
    for case in catalogue():
        if case.name == name:
            return case
    raise InputError(f"no case {name!r}", where="hard cases", expected="a name that pftwin hard-cases --list shows")


__all__ = [
    "CONTACTS",
    "DTYPES",
    "INTEGRATORS",
    "Case",
    "Cell",
    "Selection",
    "case_named",
    "catalogue",
    "method_named",
    "results",
    "run_matrix",
]
