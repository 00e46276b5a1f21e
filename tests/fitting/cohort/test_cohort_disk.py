"""A disk that is full and folders that cannot be written to: reported at the end, and the others go on."""

from __future__ import annotations

import os
import resource
from pathlib import Path
from typing import Any

import pytest
from cheap_cohort import CheapWork, cheap

from fitting.cohort import run_cohort
from fitting.cohort.folder import check_cohort
from pftwin.base.errors import OutputError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")


class LargeB(CheapWork):
    """The store of B is larger than the others."""

    def predict(self, patient, estimate, tell) -> Any:
        self.size = 100_000 if patient.name == "B" else 3
        return super().predict(patient, estimate, tell)


@pytest.fixture
def little_room():
    """No file of more than 200 kB can be written: what comes back is an OSError in the middle of a file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_store_that_does_not_fit(tmp_path, little_room):
    cohort = cheap(tmp_path, 3)
    report = run_cohort(cohort, work=LargeB())
    assert [o.status for o in report.outcomes] == ["done", "failed", "done"]
    failure = report.outcomes[1].failure
    assert failure.stage == "prediction"
    assert failure.message.endswith("patients/B.nc: cannot be written: File too large")
    assert not [p for p in (cohort.output / "patients").iterdir() if p.name.startswith(".")]
    verdicts = {f.file: f.verdict for f in check_cohort(cohort)}
    assert verdicts.pop("patients/B.nc") == "not there yet"
    assert set(verdicts.values()) == {"sound"}


def test_a_full_disk_is_noticed_before_a_unit_is_computed(tmp_path, monkeypatch):
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    cohort, work = cheap(tmp_path, 2), CheapWork()
    monkeypatch.setattr("fitting.cohort.folder.tempfile.NamedTemporaryFile", full)
    report = run_cohort(cohort, work=work)
    assert work.ran == []
    assert [o.failure.message for o in report.outcomes] == [
        f"{cohort.output}/patients: cannot be written to: No space left on device"
    ] * 2


def test_a_place_that_a_folder_takes(tmp_path):
    """What permissions do to other users, a folder in the file's place does to all."""
    cohort = cheap(tmp_path, 3)
    (tmp_path / "cohort_results").mkdir()
    report = run_cohort(cohort, work=CheapWork(began=lambda p, _: _folder_for(cohort.output, p)))
    assert [o.status for o in report.outcomes] == ["done", "failed", "done"]
    assert "patients/B.fit.json: is a folder" in report.outcomes[1].failure.message


def _folder_for(output: Path, patient: str) -> None:
    if patient == "B":
        (output / "patients" / "B.fit.json").mkdir()


def test_the_folder_becomes_unwritable_on_the_way(tmp_path):
    cohort = cheap(tmp_path, 3)

    def began(patient: str, kind: str) -> None:
        if (patient, kind) == ("B", "fit"):  # for the superuser, too, there is no writing below a file
            (cohort.output / "patients").rename(tmp_path / "away")
            (cohort.output / "patients").write_text("")

    report = run_cohort(cohort, work=CheapWork(began=began))
    assert [o.status for o in report.outcomes] == ["done", "failed", "failed"]
    assert "there is no folder" in report.outcomes[1].failure.message
    assert "patients: cannot be written to" in report.outcomes[2].failure.message


def blocked(manifest: Path) -> None:
    """A folder in its place: nothing can be written there, not by the superuser either."""
    manifest.unlink()
    manifest.mkdir()


def test_a_manifest_that_cannot_be_written_is_reported_and_stops_nobody(tmp_path):
    cohort = cheap(tmp_path, 2)

    def began(patient: str, kind: str) -> None:
        if (patient, kind) == ("A", "prediction"):
            blocked(cohort.output / "manifest.json")

    work = CheapWork(began=began)
    report = run_cohort(cohort, work=work)
    assert len(work.ran) == 4
    assert not report.failed
    assert not report.sound
    assert "manifest.json: is a folder" in report.unwritten["manifest"]


def test_a_manifest_that_is_written_at_last_holds_everything(tmp_path):
    cohort = cheap(tmp_path, 2)

    def began(patient: str, kind: str) -> None:
        if (patient, kind) == ("A", "prediction"):
            blocked(cohort.output / "manifest.json")
        elif (patient, kind) == ("B", "prediction"):
            (cohort.output / "manifest.json").rmdir()

    assert run_cohort(cohort, work=CheapWork(began=began)).sound
    assert {f.verdict for f in check_cohort(cohort)} == {"sound"}


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs /proc")
def test_a_folder_that_cannot_be_written_to_is_refused_before_any_work(tmp_path):
    work = CheapWork()
    with pytest.raises(OutputError, match=r"^/proc/cohort: (cannot be made|there is no folder)"):
        run_cohort(cheap(tmp_path, 1), "/proc/cohort", work=work)
    assert work.ran == []
