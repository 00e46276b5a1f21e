"""Units of work with their keys, and manifest.json, which records finished files and failures.

A unit's key is a hash of the content of all its input files, its settings and the software versions.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, TypeAdapter, ValidationError

from fitting.cohort.description import Cohort, Patient
from pftwin.base.errors import InputError
from pftwin.base.text_files import MESH_BYTES, read_json, write_text

PATIENTS = "patients"  # folder of the units' files


@dataclass(frozen=True)
class Unit:
    """What is computed, written and recorded in one step: a patient's fit, or its predictions."""

    patient: str
    kind: Literal["fit", "prediction"]
    file: str  # in the cohort's folder
    key: str  # hash of everything that the file's content depends on


def units_of(cohort: Cohort, patient: Patient) -> tuple[Unit, ...]:
    """The units of a patient, in order. Raises InputError if the scene file, or one that it names, cannot be read."""
    inputs = _inputs(patient, cohort.allow_outside)
    if cohort.limits:
        inputs["limits"] = json.dumps(cohort.limits, sort_keys=True)
    units, before = [], ""
    if patient.fit is not None:
        before = _key("fit", inputs, {"contact": patient.contact, "fit": patient.fit})
        units.append(Unit(patient.name, "fit", f"{PATIENTS}/{patient.name}.fit.json", before))
    settings = {"contact": patient.contact, "treatments": cohort.treatments, "predict": cohort.predict, "fit": before}
    key = _key("prediction", inputs, {**settings, "name": patient.name})
    return *units, Unit(patient.name, "prediction", f"{PATIENTS}/{patient.name}.nc", key)


@cache
def versions() -> dict[str, str]:
    """Versions of pftwin and of JAX, whose compiler affects the last digits."""
    from pftwin import __version__

    return {"pftwin": __version__, "jax": version("jax"), "jaxlib": version("jaxlib")}


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal. Raises OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _key(kind: str, inputs: dict[str, str], settings: dict[str, Any]) -> str:
    text = json.dumps(
        {"kind": kind, "inputs": inputs, "settings": settings, "versions": versions()}, sort_keys=True, allow_nan=False
    )
    return hashlib.sha256(text.encode()).hexdigest()


def _inputs(patient: Patient, allow_outside: bool) -> dict[str, str]:
    """Digests of the files by their names in the scene file, so that a cohort that is moved keeps its keys."""
    if patient.scene is None:
        from pftwin.rig.recording import recording_files

        assert patient.case is not None
        return {f"case {patient.case}: {p.name}": _digest(p) for p in recording_files(patient.case)}
    from pftwin.files.scene_file.document import Document

    document = Document.read(patient.scene, allow_outside=allow_outside)
    (first, *named), folder = document.files(), document.folder
    called = {p: p.relative_to(folder).as_posix() if p.is_relative_to(folder) else str(p) for p in named}
    return {"": _digest(first), **{name: _digest(p) for p, name in called.items()}}


def _digest(path: Path) -> str:
    try:
        if (size := path.stat().st_size) > MESH_BYTES:  # its reader will report it
            return f"{size} bytes"
        return file_digest(path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=path) from error


NAME = "manifest.json"
SUMMARY = "summary.parquet"
FORMAT = "pftwin cohort manifest 1"
_EXPECTED = f"a file of {FORMAT!r}, as `pftwin cohort` writes it"


@dataclass(frozen=True)
class Entry:
    """A finished file."""

    patient: str
    kind: str
    key: str
    bytes: int
    sha256: str
    date: str
    seconds: float  # duration of its computation [s]
    versions: dict[str, str]


@dataclass(frozen=True)
class Failure:
    """Why a patient has no or incomplete results."""

    stage: str  # files, fit, prediction or summary
    error: str  # class of the error
    message: str
    traceback: str | None = None  # of an unexpected error


@dataclass(frozen=True)
class SummaryChecksums:
    """Checksums of the summary, which is written after the manifest: at any moment its file matches one of them."""

    sha256: str
    before: str | None  # None: there was no summary


def _checked_name(name: str) -> str:
    """Refuses file names that leave the manifest's folder: the manifest may come from a stranger."""
    parts = PurePosixPath(name).parts
    if len(parts) != 2 or parts[0] != PATIENTS or parts[1] == "..":
        raise ValueError(f"it names the file {name!r}")
    return name


@dataclass
class Manifest:
    """The content of `manifest.json`, which is written after every unit, complete or not at all."""

    cohort: str
    files: dict[Annotated[str, AfterValidator(_checked_name)], Entry]  # by name in the cohort's folder
    failures: dict[str, Failure]  # by patient
    summary: SummaryChecksums | None

    def record(self, unit: Unit, folder: Path, seconds: float) -> None:
        """Records a unit whose file has been written. Raises OSError if it cannot be read."""
        path = folder / unit.file
        size, digest = path.stat().st_size, file_digest(path)
        self.files[unit.file] = Entry(
            unit.patient, unit.kind, unit.key, size, digest, now(), round(seconds, 3), versions()
        )

    def holds(self, unit: Unit, folder: Path) -> bool:
        """Whether a unit is done: its file exists, unchanged, and was made for this key."""
        entry = self.files.get(unit.file)
        return entry is not None and entry.key == unit.key and file_fault(entry, folder / unit.file) is None

    def save(self, folder: Path) -> None:
        """Writes the manifest. Raises OutputError if it cannot be written."""
        content = {"format": FORMAT, "date": now(), "versions": versions(), **asdict(self)}
        write_text(folder / NAME, json.dumps(content, indent=1) + "\n")

    @staticmethod
    def load(folder: Path) -> Manifest:
        """The manifest of a folder. Raises InputError if there is none, or it is damaged."""
        path = folder / NAME
        content = read_json(path, expected=_EXPECTED)
        try:
            if content["format"] != FORMAT:
                raise ValueError(f"its format is {content['format']!r}")
            return TypeAdapter(Manifest).validate_python(content)  # ignores what a later version may have added
        except (ValueError, KeyError, TypeError) as error:
            said = str(error)
            if isinstance(error, ValidationError):
                first = error.errors()[0]
                said = f"{', '.join(map(repr, first['loc']))}: {first['msg'].removeprefix('Value error, ')}"
            remedy = "another folder (--out); or, to compute everything anew, empty this one"
            raise InputError(f"no manifest: {said}", where=path, expected=_EXPECTED, remedy=remedy) from None


def file_fault(entry: Entry, path: Path) -> str | None:
    """What is wrong with a finished file, in words; None if nothing is."""
    try:
        size = path.stat().st_size
        if size != entry.bytes:
            return f"{size} bytes in place of {entry.bytes}"
        return None if file_digest(path) == entry.sha256 else "its checksum differs"
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read: {error.strerror or error}"


def now() -> str:
    """The date and time, in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")
