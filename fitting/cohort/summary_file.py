"""The summary's file, kept up to date after every patient."""

from __future__ import annotations

import hashlib
from pathlib import Path

from fitting.cohort.description import Cohort
from fitting.cohort.manifest import SUMMARY, Announced, Failure, Manifest
from fitting.cohort.summary import Row, Units, row_without, rows_of, table
from fitting.cohort.units import Unit, file_digest, versions
from pftwin.base.output import written_whole


class SummaryFile:
    """Rows of the patients that are done, as their stores hold them."""

    def __init__(self, cohort: Cohort, folder: Path, manifest: Manifest) -> None:
        self.cohort, self.folder, self.manifest = cohort, folder, manifest
        self.rows: dict[str, list[Row]] = {}
        self.units: Units = {}

    def take(self, patient: str, unit: Unit) -> None:
        """Reads a patient's store.

        Raises:
            InputError: it is none.
        """
        self.rows[patient], units = rows_of(self.folder / unit.file)
        self.units |= units

    def write(self, failures: dict[str, Failure]) -> None:
        """Announces the summary in the manifest, then writes it; not at all where it is there already.

        Raises:
            OutputError: the manifest or the summary cannot be written.
        """
        rows: list[Row] = []
        for patient in self.cohort.patients:
            failure = failures.get(patient.name)
            done = self.rows.get(patient.name) if failure is None else None
            rows += done or [row_without(patient.name, failure)]
        content = table(rows, self.units, {"cohort": self.cohort.name, **versions()})
        path, digest = self.folder / SUMMARY, hashlib.sha256(content).hexdigest()
        there = file_digest(path) if path.is_file() else None
        self.manifest.summary = Announced(digest, there)
        self.manifest.save(self.folder)
        if there == digest:
            return
        with written_whole(path) as temporary:
            temporary.write_bytes(content)
