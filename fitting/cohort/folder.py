"""A cohort's folder of results: locks it for one process, removes a killed one's leftovers, and checks its files."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from fitting.cohort.description import Cohort
from fitting.cohort.manifest import NAME, PATIENTS, SUMMARY, Manifest, file_digest, file_fault, units_of
from pftwin.base.errors import InputError, OutputError
from pftwin.base.output import make_folder, remove_unfinished

SOUND, DAMAGED, OUTDATED, ABSENT, LEFT_OVER = (
    "sound",
    "damaged",
    "out of date",
    "not there yet",
    "no longer in the list",
)
LOCK = ".lock"
_ANOTHER = "another folder, with --out"
_PROBE = bytes(1 << 16)
# Names that `written_whole` gives to unfinished files: ".NAME." and eight letters.
_UNFINISHED = {
    "": re.compile(r"^\.(?:manifest\.[a-z0-9_]{8}\.json|summary\.[a-z0-9_]{8}\.parquet)$"),
    PATIENTS: re.compile(r"^\.[A-Za-z0-9_.-]+\.[a-z0-9_]{8}\.(?:json|nc)$"),
}


@contextmanager
def opened(folder: Path, cohort: str, *, resume: bool) -> Iterator[Manifest]:
    """The folder's manifest, while no other process works there; makes the folder if needed. Raises InputError if it
    holds results without `resume`, those of another cohort, or a damaged manifest, or another process is at work there.
    Raises OutputError if it cannot be made or written to."""
    make_folder(folder, _ANOTHER)
    with _locked(folder):
        manifest = _existing_or_new(folder, cohort, resume)
        for place, unfinished in _UNFINISHED.items():
            remove_unfinished(folder / place, unfinished)
        manifest.save(folder)
        make_folder(folder / PATIENTS, _ANOTHER)
        yield manifest


def check_room(folder: Path) -> None:
    """Checks that a folder can be written to, before hours are spent on its content. Raises OutputError if it cannot,
    or the disk is full."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".room.", suffix=".nc") as file:
            file.write(_PROBE)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error.strerror or error}") from error


def _existing_or_new(folder: Path, cohort: str, resume: bool) -> Manifest:
    """The existing manifest, or a new one."""
    if not (folder / NAME).exists():
        if there := [name for name in (PATIENTS, SUMMARY) if (folder / name).exists()]:
            expected = "an empty folder, or one that pftwin cohort wrote"
            raise InputError(f"holds {there[0]} and no {NAME}", where=folder, expected=expected, remedy=_ANOTHER)
        return Manifest(cohort, {}, {}, None)
    manifest = Manifest.load(folder)
    if manifest.cohort != cohort:
        problem = f"holds results of the cohort {manifest.cohort!r}"
        raise InputError(problem, where=folder, expected=f"those of {cohort!r}", remedy=_ANOTHER)
    if not resume and (manifest.files or manifest.failures):
        raise InputError(
            f"holds results of this cohort already: {len(manifest.files)} finished files",
            where=folder,
            remedy="--resume, which computes what is missing or no longer up to date; or another folder, with --out",
        )
    return manifest


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Locks the folder; the system releases the lock when the process ends, however it ends."""
    try:
        file = (folder / LOCK).open("w")
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error.strerror or error}") from error
    with file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # Windows: two processes at once repeat work, which is harmless
            pass
        except BlockingIOError:
            remedy = "wait for it, or another folder with --out"
            raise InputError("another process works on this cohort", where=folder, remedy=remedy) from None
        except OSError:  # a file system without locks
            pass
        yield


class FileFinding(NamedTuple):
    """The result of a check of one file."""

    file: str
    verdict: str
    words: str = ""


def check_cohort(cohort: Cohort, folder: str | os.PathLike[str] | None = None) -> list[FileFinding]:
    """Checks every file of a cohort's folder against checksum and key. Reads all of them; changes nothing.

    Raises:
        InputError: no manifest, or a damaged one.
    """
    place = Path(cohort.output if folder is None else folder)
    manifest = Manifest.load(place)
    found: dict[str, FileFinding] = {}
    for name, entry in manifest.files.items():
        wrong = file_fault(entry, place / name)
        found[name] = FileFinding(name, LEFT_OVER if wrong is None else DAMAGED, wrong or "")
    asked: list[FileFinding] = []
    for patient in cohort.patients:
        try:
            units = units_of(cohort, patient)
        except InputError as error:
            mine = [n for n, entry in manifest.files.items() if entry.patient == patient.name]
            old = [found.pop(n) for n in mine]
            asked += [f if f.verdict == DAMAGED else FileFinding(f.file, OUTDATED, str(error)) for f in old]
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


def _summary(manifest: Manifest, path: Path) -> FileFinding:
    """Checks the summary: a killed run may have left one that lacks the last patient."""
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
