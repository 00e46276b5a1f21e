"""Reads a cohort file: which patients, how they are fitted, and which treatments are predicted for them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, create_model, model_validator

from fitting.nuisance import Nuisance
from fitting.treatments import KINDS
from fitting.treatments.treatment import Way
from pftwin.base.errors import InputError
from pftwin.base.text_files import shortened_list
from pftwin.base.written_amounts import several_amounts
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.problems import validated
from pftwin.files.scene_file.section import FileName, Positive, Section, problem

_UNITS = {"mm": "mm", "deg": "deg", "%": "percent"}  # as names of fields spell them
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}


def _file_name(name: str) -> str:
    if name.lower() in _DEVICES:
        raise problem(f"found {name!r}, which Windows takes for a device", expected="another name")
    return name


def _amounts(given: Any) -> list[float]:
    """Values in the field's unit, from a number, a list of numbers, or a text such as "0:20:5"."""
    if isinstance(given, str):
        try:
            return several_amounts(given, "")
        except InputError as error:
            raise problem(error.problem, expected=error.expected) from None
    listed = given if isinstance(given, list) else [given]
    numbers = [float(v) for v in listed if isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e300]
    if not listed or len(numbers) < len(listed):
        raise problem(f"found {given!r}", expected='a number, a list of numbers, or "FROM:TO:STEP"')
    return numbers


# Patients' files are named after them, so names must be valid on every system.
PatientName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"), AfterValidator(_file_name)]


Names = Annotated[list[str], Field(min_length=1)]
Count = Annotated[int, Field(ge=1)]
Method = Literal["least_squares", "gradient", "genetic", "matlab_ga", "cma_es", "differential_evolution", "simulations"]


def _nuisance(given: str) -> str:
    """The text, if `fitting.Nuisance.of` accepts it."""
    try:
        Nuisance.of(given)
    except InputError as error:
        raise problem(error.problem, expected=error.expected) from None
    return given


def _optional(description: str) -> Any:
    return Field(default=None, description=description)


class FitTable(Section):
    """How tendons are fitted: options of `fitting.fit_tendons`, with the same defaults."""

    free: Names | None = _optional("parameters")
    bounds: Positive | None = _optional("to either side, as a share of the nominal value")
    use: Names | Literal["all"] | None = _optional('channels that are compared, in a list, or "all"')
    noise: dict[str, Positive] | None = _optional("standard deviations by channel, in m, rad or N")
    method: Method | None = _optional("how the best parameters, or the posterior, are found")
    nuisance: Annotated[str, AfterValidator(_nuisance)] | None = _optional(
        'nuisance parameters to fit: "rig", "mocap", "mri", or deviations'
    )
    objective: Literal["likelihood", "paper"] | None = _optional("what makes a fit good")
    loss: Literal["linear", "huber", "soft_l1"] | None = _optional("how outliers count")
    starts: Count | None = _optional("starting points (least squares, gradient)")
    simulations: Annotated[int, Field(ge=1000)] | None = _optional("of each round (simulations)")
    rounds: Count | None = _optional("at most (simulations)")
    seed: Annotated[int, Field(ge=0)] | None = _optional("of all random choices")


class PredictTable(Section):
    """How treatments are simulated: the options of `pftwin treat`."""

    samples: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=50, description="draws from the fit's uncertainty, for bands"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="of the draws")
    dt_s: Positive | None = _optional("longest time step [s]; left out: 0.0005, or shorter where errors ask for it")


class PatientTable(Section):
    """One knee: a scene with its recording."""

    name: PatientName = Field(description="letters, digits, _ and -; files are named after it")
    scene: FileName | None = _optional("its scene file")
    case: Annotated[int, Field(ge=1, le=4)] | None = _optional("instead of a scene file: a case of the virtual rig")
    contact: str | None = _optional("patch in place of the scene's own: P2, P4, P5, spline")
    fit: FitTable | None = _optional("table: what is other than in [fit] for this patient")

    @model_validator(mode="after")
    def _one_scene(self) -> PatientTable:
        if (self.scene is None) == (self.case is None):
            found = "neither scene nor case" if self.scene is None else "both scene and case"
            raise problem(f"{found} given", expected='one of them: scene = "knee.toml"')
        return self


def amount_field(name: str, way: Way) -> str:
    """The field of a treatment's amount in the file: its name with its unit."""
    return f"{name}_{_UNITS[way.shown_unit]}"


def _kind_table(kind: str) -> type[Section]:
    ways = KINDS[kind].amounts
    fields: Any = {
        amount_field(name, way): (
            Annotated[list[float] | None, BeforeValidator(_amounts)],
            _optional(f'{way.more} [{way.shown_unit}]: a number, a list, or "FROM:TO:STEP"'),
        )
        for name, way in ways.items()
    }
    return create_model(f"{kind}_table", __base__=Section, __doc__=f"Amounts of {kind}.", **fields)


class _TreatmentTable(Section):
    """One treatment, of one kind or of several in sequence: all combinations of its amounts."""

    @model_validator(mode="after")
    def _something(self) -> _TreatmentTable:
        if not self.amounts():
            expected = 'such as tibial_tuberosity_transfer = { medialisation_mm = "0:20:5" }'
            raise problem("no treatment given", expected=expected)
        return self

    def amounts(self) -> dict[str, dict[str, list[float]]]:
        """Values by kind and amount, as written: mm, degrees and percent."""
        found: dict[str, dict[str, list[float]]] = {}
        for kind, about in KINDS.items():
            table = getattr(self, kind, None)
            given = {n: getattr(table, amount_field(n, way), None) for n, way in about.amounts.items()}
            if there := {n: v for n, v in given.items() if v is not None}:
                found[kind] = there
        return found


_KINDS: Any = {k: (_kind_table(k) | None, _optional(f"table: {KINDS[k].part}")) for k in KINDS}
if TYPE_CHECKING:
    TreatmentTable = _TreatmentTable
else:
    TreatmentTable = create_model("TreatmentTable", __base__=_TreatmentTable, __doc__=_TreatmentTable.__doc__, **_KINDS)


class CohortTable(Section):
    """The whole file."""

    schema_version: Literal[1] = Field(alias="schema", description="version of this format: schema = 1")
    name: FileName | None = _optional("the cohort's name; the file's by default")
    output: FileName | None = _optional("folder of the results; NAME_results by default")
    fit: FitTable | None = _optional("table: how tendons are fitted; without it nothing is")
    predict: PredictTable = Field(default_factory=PredictTable, description="table: how treatments are simulated")
    treatment: list[TreatmentTable] = Field(default=[], description="tables [[treatment]]: what is predicted")
    patient: Annotated[list[PatientTable], Field(min_length=1)] = Field(description="tables [[patient]]: who")

    @model_validator(mode="after")
    def _something_to_do(self) -> CohortTable:
        if self.fit is None and not self.treatment:
            raise problem("neither a fit nor a treatment", expected="a table [fit], tables [[treatment]], or both")
        return self


_MOST_MEMBERS = 1_000_000  # most simulations of a patient: variants times draws

Amounts = dict[str, dict[str, list[float]]]  # of one treatment, by kind and amount; mm, degrees and percent


@dataclass(frozen=True)
class Patient:
    """One knee of a cohort."""

    name: str
    scene: Path | None  # scene file, or None if it is a case
    case: int | None  # case of the virtual rig
    contact: str | None
    fit: dict[str, Any] | None  # options of `fitting.fit_tendons`; None: parameters stay as in the scene


@dataclass(frozen=True)
class Cohort:
    """The content of a cohort file."""

    name: str
    path: Path
    output: Path
    patients: tuple[Patient, ...]
    treatments: tuple[Amounts, ...]
    predict: dict[str, Any]  # samples, seed, dt [s]
    allow_outside: bool = False  # whether scene files may name files outside their folders
    limits: Mapping[str, float] = field(default_factory=dict)  # plausibility limits that replace the scene files'


def read_cohort(
    path: str | os.PathLike[str], *, allow_outside: bool = False, limits: Mapping[str, float] | None = None
) -> Cohort:
    """Reads a cohort's TOML file. Scene files are not read here: a broken one is reported with its patient.

    Args:
        path: the file; relative paths in it start at its folder.
        allow_outside: whether it, and the scene files, may name files outside their folders.
        limits: limits of plausible knees (`pftwin.model.limits.Limits`), by name, that replace those of scene files.

    Raises:
        InputError: a file that cannot be read, unknown or missing fields, invalid values, two patients of one name; one
            message lists every problem with its line and field.
    """
    table, document = validated(Document.read(path, allow_outside=allow_outside), CohortTable)
    _check_names(table, document)
    treatments = tuple(t.amounts() for t in table.treatment)
    _check_size(treatments, table, document)
    patients = tuple(_patient(p, i, table, document) for i, p in enumerate(table.patient))
    with document.naming("output"):
        output = _inside(document, table.output or f"{document.path.stem}_results")
    predict = {"samples": table.predict.samples, "seed": table.predict.seed, "dt": table.predict.dt_s}
    name = table.name or document.path.stem
    return Cohort(name, document.path, output, patients, treatments, predict, allow_outside, dict(limits or {}))


def _patient(table: PatientTable, i: int, cohort: CohortTable, document: Document) -> Patient:
    scene = contact = fit = None
    if table.scene is not None:
        with document.naming("patient", i, "scene"):
            scene = _inside(document, table.scene)
    if table.contact is not None:
        with document.naming("patient", i, "contact"):
            contact = _contact(table)
    if given := [one.model_dump(exclude_none=True) for one in (cohort.fit, table.fit) if one is not None]:
        fit = {name: value for one in given for name, value in one.items()}
    return Patient(table.name, scene, table.case, contact, fit)


def _inside(document: Document, name: str) -> Path:
    """As `Document.file`, with a message that fits this file."""
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
        expected = "a polynomial or spline; meshes are of the rig's cases"
        raise InputError(f"{contact} for a scene file", expected=expected)
    return contact


def _check_names(table: CohortTable, document: Document) -> None:
    """Raises InputError for names that differ only in case, which many file systems do not distinguish."""
    names = [p.name.lower() for p in table.patient]
    for name in names:
        if len(same := [i for i, other in enumerate(names) if other == name]) > 1:
            where, *others = (document.where("patient", i, "name") for i in same)
            also = shortened_list([other.removeprefix(f"{document.path}, ") for other in others], 3)
            found = f"{len(same)} patients are called {table.patient[same[0]].name!r}, also {also}"
            raise InputError(found, where=where, expected="names that differ by more than capital letters")


def _check_size(treatments: tuple[Amounts, ...], table: CohortTable, document: Document) -> None:
    variants = sum(math.prod(len(v) for amounts in t.values() for v in amounts.values()) for t in treatments)
    if (members := variants * (1 + table.predict.samples)) > _MOST_MEMBERS:
        raise InputError(
            f"{variants} variants and {table.predict.samples} samples of each",
            where=document.path,
            expected=f"at most {_MOST_MEMBERS} simulations of a patient, and not {members}",
            remedy="longer steps in [[treatment]], or fewer samples in [predict]",
        )
