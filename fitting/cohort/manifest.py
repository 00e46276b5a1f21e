"""manifest.json: every finished file of a cohort with its size, checksum and key; what failed, and why."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from fitting.cohort.units import PATIENTS, Unit, file_digest, versions
from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.base.text_files import read_json

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
    seconds: float  # that its unit took
    versions: dict[str, str]


@dataclass(frozen=True)
class Failure:
    """Why a patient has no results, or not all."""

    stage: str  # files, fit, prediction or summary
    error: str  # its kind
    message: str
    traceback: str | None = None  # of what was not foreseen


@dataclass(frozen=True)
class Announced:
    """The summary, which is written after the manifest: at any moment its checksum is the one or the other."""

    sha256: str
    before: str | None  # None: there was no summary


@dataclass
class Manifest:
    """What `manifest.json` holds. It is written after every unit, whole or not at all."""

    cohort: str
    files: dict[str, Entry] = field(default_factory=dict)  # by name in the cohort's folder
    failures: dict[str, Failure] = field(default_factory=dict)  # by patient
    summary: Announced | None = None

    def record(self, unit: Unit, folder: Path, seconds: float) -> None:
        """Takes up a unit whose file has been written.

        Raises:
            OSError: it cannot be read.
        """
        path = folder / unit.file
        size, digest = path.stat().st_size, file_digest(path)
        self.files[unit.file] = Entry(
            unit.patient, unit.kind, unit.key, size, digest, now(), round(seconds, 3), versions()
        )

    def holds(self, unit: Unit, folder: Path) -> bool:
        """Whether a unit is done: its file is there as it was written, with this key."""
        entry = self.files.get(unit.file)
        return entry is not None and entry.key == unit.key and fault(entry, folder / unit.file) is None

    def save(self, folder: Path) -> None:
        """Writes it.

        Raises:
            OutputError: it cannot be written.
        """
        content = {"format": FORMAT, "date": now(), "versions": versions(), **asdict(self)}
        with written_whole(folder / NAME) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def load(folder: Path) -> Manifest:
        """The manifest of a folder.

        Raises:
            InputError: there is none, or it is damaged.
        """
        path = folder / NAME
        content = read_json(path, expected=_EXPECTED)
        try:
            if content["format"] != FORMAT:
                raise ValueError(f"its format is {content['format']!r}")
            files = {_checked_name(name): _made(Entry, entry) for name, entry in content["files"].items()}
            failures = {name: _made(Failure, failure) for name, failure in content["failures"].items()}
            summary = None if content["summary"] is None else _made(Announced, content["summary"])
            return Manifest(str(content["cohort"]), files, failures, summary)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            remedy = "another folder (--out); or, to compute everything anew, empty this one"
            raise InputError(f"no manifest: {error}", where=path, expected=_EXPECTED, remedy=remedy) from None


def fault(entry: Entry, path: Path) -> str | None:
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


def _made(kind: type[Any], content: dict[str, Any]) -> Any:
    """Fields that a later version may have added are passed over."""
    known = {f.name for f in fields(kind)}
    return kind(**{k: v for k, v in content.items() if k in known})


def _checked_name(name: str) -> str:
    """A manifest may be a stranger's: it names files in its own folder alone."""
    parts = PurePosixPath(name).parts
    if len(parts) != 2 or parts[0] != PATIENTS or parts[1] == "..":
        raise ValueError(f"it names the file {name!r}")
    return name
