"""Whether a cohort's folder holds what its manifest says, and what its cohort file asks for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from fitting.cohort.description import Cohort
from fitting.cohort.manifest import SUMMARY, Manifest, fault
from fitting.cohort.units import file_digest, units_of
from pftwin.base.errors import InputError

SOUND, DAMAGED, OUTDATED, ABSENT, LEFT_OVER = "sound", "damaged", "out of date", "not there yet", "no longer asked for"


class FileFinding(NamedTuple):
    """About one file."""

    file: str
    verdict: str
    words: str = ""


def check_cohort(cohort: Cohort, folder: str | os.PathLike[str] | None = None) -> list[FileFinding]:
    """Every file of a cohort's folder against checksum and key. Reads all of them; changes nothing.

    Raises:
        InputError: no manifest, or a damaged one.
    """
    place = Path(cohort.output if folder is None else folder)
    manifest = Manifest.load(place)
    found: dict[str, FileFinding] = {}
    for name, entry in manifest.files.items():
        wrong = fault(entry, place / name)
        found[name] = FileFinding(name, LEFT_OVER if wrong is None else DAMAGED, wrong or "")
    asked: list[FileFinding] = []
    for patient in cohort.patients:
        try:
            units = units_of(cohort, patient)
        except InputError as error:
            mine = [n for n, entry in manifest.files.items() if entry.patient == patient.name]
            asked += [found.pop(n) if found[n].verdict == DAMAGED else _outdated(found.pop(n), error) for n in mine]
            asked += [] if mine else [FileFinding(patient.name, ABSENT, str(error))]
            continue
        for unit in units:
            there = found.pop(unit.file, None)
            if there is None:
                why = manifest.failures.get(patient.name)
                asked.append(FileFinding(unit.file, ABSENT, "" if why is None else why.message))
            elif there.verdict == DAMAGED:
                asked.append(there)
            elif manifest.files[unit.file].key != unit.key:
                asked.append(FileFinding(unit.file, OUTDATED, "made from other files, settings or versions"))
            else:
                asked.append(FileFinding(unit.file, SOUND))
    return [*asked, *found.values(), _summary(manifest, place / SUMMARY)]


def _outdated(finding: FileFinding, error: InputError) -> FileFinding:
    return FileFinding(finding.file, OUTDATED, str(error))


def _summary(manifest: Manifest, path: Path) -> FileFinding:
    """A run that was killed may have left the summary before the last patient's."""
    try:
        digest = file_digest(path) if path.is_file() else None
    except OSError as error:
        return FileFinding(SUMMARY, DAMAGED, f"cannot be read: {error.strerror or error}")
    announced = manifest.summary
    if announced is not None and digest == announced.sha256:
        return FileFinding(SUMMARY, SOUND)
    if digest is None and (announced is None or announced.before is None):
        return FileFinding(SUMMARY, ABSENT)
    if announced is not None and digest == announced.before:
        return FileFinding(SUMMARY, OUTDATED, "the run ended before the last patient was in it")
    return FileFinding(SUMMARY, DAMAGED, "is missing" if digest is None else "its checksum differs")
