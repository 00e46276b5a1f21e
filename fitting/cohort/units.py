"""Units of work and their keys: the content of all files that go in, the settings, and the versions."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from fitting.cohort.description import Cohort, Patient
from pftwin.base.errors import InputError
from pftwin.base.text_files import MESH_BYTES

PATIENTS = "patients"  # folder of the units' files
_CHUNK = 2**20


@dataclass(frozen=True)
class Unit:
    """What is computed, written and recorded at once: a patient's fit, or its predictions."""

    patient: str
    kind: Literal["fit", "prediction"]
    file: str  # in the cohort's folder
    key: str  # of all that the file's content depends on


def units_of(cohort: Cohort, patient: Patient) -> tuple[Unit, ...]:
    """The units of a patient, in their order.

    Raises:
        InputError: the scene file, or a file that it names, cannot be read.
    """
    inputs = _inputs(patient, cohort.allow_outside)
    units, before = [], ""
    if patient.fit is not None:
        before = _key("fit", inputs, {"contact": patient.contact, "fit": patient.fit})
        units.append(Unit(patient.name, "fit", f"{PATIENTS}/{patient.name}.fit.json", before))
    settings = {"contact": patient.contact, "treatments": cohort.treatments, "predict": cohort.predict, "fit": before}
    key = _key("prediction", inputs, {**settings, "name": patient.name})
    return *units, Unit(patient.name, "prediction", f"{PATIENTS}/{patient.name}.nc", key)


@cache
def versions() -> dict[str, str]:
    """Of pftwin and of JAX, whose compiler has a say in the last digits."""
    from pftwin import __version__

    return {"pftwin": __version__, "jax": version("jax"), "jaxlib": version("jaxlib")}


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal.

    Raises:
        OSError: it cannot be read.
    """
    found = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            found.update(chunk)
    return found.hexdigest()


def _key(kind: str, inputs: dict[str, str], settings: dict[str, Any]) -> str:
    text = json.dumps(
        {"kind": kind, "inputs": inputs, "settings": settings, "versions": versions()}, sort_keys=True, allow_nan=False
    )
    return hashlib.sha256(text.encode()).hexdigest()


def _inputs(patient: Patient, allow_outside: bool) -> dict[str, str]:
    """Digests of the files, by their names as the scene file has them: a cohort that is moved keeps its keys."""
    if patient.scene is None:
        from pftwin.rig.recording import recording_files

        assert patient.case is not None
        return {f"case {patient.case}: {p.name}": _digest(p) for p in recording_files(patient.case)}
    from pftwin.files.scene_file.document import Document

    document = Document.read(patient.scene, allow_outside=allow_outside)
    first, *named = document.files()
    folder = document.folder
    return {"": _digest(first), **{_called(p, folder): _digest(p) for p in named}}


def _called(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


def _digest(path: Path) -> str:
    try:
        if (size := path.stat().st_size) > MESH_BYTES:  # no reader takes it, and says so
            return f"{size} bytes"
        return file_digest(path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=path) from error
