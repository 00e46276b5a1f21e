"""A cohort file: which patients, how they are fitted, and which treatments are predicted for them."""

from __future__ import annotations

import math
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fitting.cohort.tables import CohortTable, PatientTable
from pftwin.base.errors import InputError
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.problems import scene_error
from pftwin.files.scene_file.section import Reading

_MOST_MEMBERS = 1_000_000  # variants and draws of a patient

Amounts = dict[str, dict[str, list[float]]]  # of one treatment, by kind and amount; mm, degrees and percent


@dataclass(frozen=True)
class Patient:
    """One knee of a cohort."""

    name: str
    scene: Path | None  # or
    case: int | None  # of the virtual rig
    contact: str | None
    fit: dict[str, Any] | None  # options of `fitting.fit_tendons`; None: parameters stay as in the scene


@dataclass(frozen=True)
class Cohort:
    """What a cohort file says."""

    name: str
    path: Path
    output: Path
    patients: tuple[Patient, ...]
    treatments: tuple[Amounts, ...]
    predict: dict[str, Any]  # samples, seed, dt [s]
    allow_outside: bool = False  # whether scene files may name files outside their folders


def read_cohort(path: str | os.PathLike[str], *, allow_outside: bool = False) -> Cohort:
    """What a TOML file says of a cohort. Scene files are named, not read: a broken one is its patient's matter.

    Args:
        path: the file; relative paths in it start at its folder.
        allow_outside: whether it, and the scene files, may name files outside their folders.

    Raises:
        InputError: a file that cannot be read, unknown or missing fields, values that cannot be right, two patients of
            one name; one message that lists every problem with its line and field.
    """
    document = Document.read(path, allow_outside=allow_outside)
    reading = Reading()
    try:
        table = CohortTable.model_validate(document.data, context=reading)
    except ValidationError as error:
        raise scene_error(error, document, reading) from None
    _check_names(table, document)
    treatments = tuple(t.amounts() for t in table.treatment)
    _check_size(treatments, table, document)
    patients = tuple(_patient(p, i, table, document) for i, p in enumerate(table.patient))
    with document.naming("output"):
        output = _inside(document, table.output or f"{document.path.stem}_results")
    predict = {"samples": table.predict.samples, "seed": table.predict.seed, "dt": table.predict.dt_s}
    name = table.name or document.path.stem
    return Cohort(name, document.path, output, patients, treatments, predict, allow_outside)


def _patient(table: PatientTable, i: int, cohort: CohortTable, document: Document) -> Patient:
    scene = None
    if table.scene is not None:
        with document.naming("patient", i, "scene"):
            scene = _inside(document, table.scene)
    contact = None
    if table.contact is not None:
        with document.naming("patient", i, "contact"):
            contact = _contact(table)
    fit = None
    if cohort.fit is not None or table.fit is not None:
        fit = {**(cohort.fit.options() if cohort.fit else {}), **(table.fit.options() if table.fit else {})}
    return Patient(table.name, scene, table.case, contact, fit)


def _inside(document: Document, name: str) -> Path:
    """As `Document.file`, in words that fit this file."""
    try:
        return document.file(name)
    except InputError:
        raise InputError(
            f"{name!r} leads out of the cohort file's folder",
            expected="a path in that folder",
            remedy="if you know where the cohort file comes from: pftwin --allow-outside cohort ...",
        ) from None


def _contact(table: PatientTable) -> str:
    from pftwin.rig.contacts import ON_MESHES, parse_contact

    contact = parse_contact(str(table.contact))
    if table.scene is not None and contact in ON_MESHES:
        raise InputError(
            f"{contact} for a scene file", expected="a polynomial or spline; meshes are of the rig's cases"
        )
    return contact


def _check_names(table: CohortTable, document: Document) -> None:
    """Case does not count: on many systems it does not in files' names."""
    counts = Counter(p.name.lower() for p in table.patient)
    for i, patient in enumerate(table.patient):
        if counts[patient.name.lower()] > 1:
            place, _, _ = document.locate(("patient", i, "name"))
            raise InputError(
                f"{counts[patient.name.lower()]} patients are called {patient.name!r}",
                where=document.describe(place),
                expected="names that differ by more than capital letters",
            )


def _check_size(treatments: tuple[Amounts, ...], table: CohortTable, document: Document) -> None:
    variants = sum(math.prod(len(v) for amounts in t.values() for v in amounts.values()) for t in treatments)
    if (members := variants * (1 + table.predict.samples)) > _MOST_MEMBERS:
        raise InputError(
            f"{variants} variants and {table.predict.samples} samples of each",
            where=document.path,
            expected=f"at most {_MOST_MEMBERS} simulations of a patient, and not {members}",
            remedy="longer steps in [[treatment]], or fewer samples in [predict]",
        )
