"""The folder of a cohort's results: opened by one process at a time, and cleared of what a killed one left."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from fitting.cohort.manifest import NAME, SUMMARY, Manifest
from fitting.cohort.units import PATIENTS
from pftwin.base.errors import InputError, OutputError
from pftwin.base.output import make_folder, remove_unfinished

LOCK = ".lock"
_ANOTHER = "another folder, with --out"
_PROBE = bytes(1 << 16)
# What `written_whole` calls the files that it has not finished: ".NAME." and eight letters.
_UNFINISHED = {
    "": re.compile(r"^\.(?:manifest\.[a-z0-9_]{8}\.json|summary\.[a-z0-9_]{8}\.parquet)$"),
    PATIENTS: re.compile(r"^\.[A-Za-z0-9_.-]+\.[a-z0-9_]{8}\.(?:json|nc)$"),
}


@contextmanager
def opened(folder: Path, cohort: str, *, resume: bool) -> Iterator[Manifest]:
    """The folder's manifest, while no other process works there.

    Args:
        folder: made if it is not there.
        cohort: its name.
        resume: whether to go on with what the folder holds.

    Raises:
        InputError: it holds results and nobody said to go on with them, those of another cohort, a damaged manifest, or
            another process is at work there.
        OutputError: it cannot be made or written to.
    """
    make_folder(folder, _ANOTHER)
    with _locked(folder):
        manifest = _found(folder, cohort, resume)
        for place, unfinished in _UNFINISHED.items():
            remove_unfinished(folder / place, unfinished)
        manifest.save(folder)
        make_folder(folder / PATIENTS, _ANOTHER)
        yield manifest


def check_room(folder: Path) -> None:
    """Refuses a folder that could not take a file, before hours are spent on the file's content.

    Raises:
        OutputError: it cannot be written to, or the disk is full.
    """
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".room.", suffix=".nc") as file:
            file.write(_PROBE)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error.strerror or error}") from error


def _found(folder: Path, cohort: str, resume: bool) -> Manifest:
    """The manifest that is there, or a new one."""
    if not (folder / NAME).exists():
        if there := [name for name in (PATIENTS, SUMMARY) if (folder / name).exists()]:
            raise InputError(
                f"holds {there[0]} and no {NAME}",
                where=folder,
                expected="an empty folder, or one that pftwin cohort wrote",
                remedy=_ANOTHER,
            )
        return Manifest(cohort)
    manifest = Manifest.load(folder)
    if manifest.cohort != cohort:
        raise InputError(
            f"holds results of the cohort {manifest.cohort!r}",
            where=folder,
            expected=f"those of {cohort!r}",
            remedy=_ANOTHER,
        )
    if not resume and (manifest.files or manifest.failures):
        raise InputError(
            f"holds results of this cohort already: {len(manifest.files)} finished files",
            where=folder,
            remedy="--resume, which computes what is missing or no longer up to date; or another folder, with --out",
        )
    return manifest


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """The system lets go of the lock when the process ends, however it ends."""
    try:
        file = (folder / LOCK).open("w")
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error.strerror or error}") from error
    with file:
        _lock(file, folder)
        yield


def _lock(file: IO[str], folder: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows: two processes at once do work twice, and no harm
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            "another process works on this cohort", where=folder, remedy="wait for it, or another folder with --out"
        ) from None
    except OSError:  # a file system without locks
        return
