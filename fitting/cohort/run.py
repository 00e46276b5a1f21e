"""`run_cohort`: computes, writes and records a cohort's units; a failure does not stop the others."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.cohort.description import Cohort, Patient
from fitting.cohort.folder import check_room, opened
from fitting.cohort.manifest import PATIENTS, Failure, Manifest, Unit, units_of
from fitting.cohort.report import CohortProgress, CohortReport, Pace, PatientOutcome
from fitting.cohort.summary import SummaryFile, require_pyarrow, write_store
from pftwin.base.errors import InputError, PftwinError

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate
    from pftwin.model.scene import Scene

Tell = Callable[[float], None]  # called with the share of a unit that is done


class Work:
    """Computes units with `fitting.fit_tendons` and `fitting.predict`."""

    def __init__(self, cohort: Cohort) -> None:
        self.cohort = cohort
        self._last: tuple[Patient, Scene] | None = None  # a patient's units follow each other

    def scene_facts(self, patient: Patient) -> dict[str, Any]:
        """The scene's name (`scene`), and whether its motion or measurements are synthetic (`synthetic`, 0 or 1)."""
        scene = self._scene(patient)
        measured = scene.measured is not None and scene.measured.synthetic
        return {"scene": scene.name, "synthetic": int(scene.synthetic or measured)}

    def fit(self, patient: Patient, tell: Tell) -> Estimate:
        """Fits the patient's parameters. Raises InputError as `fitting.fit_tendons` does, PftwinError if the estimate
        is INVALID, and KeyboardInterrupt after Ctrl-C, which discards an unfinished fit."""
        from fitting.fit import fit_tendons

        scene = self._scene(patient)
        estimate = fit_tendons(scene, progress=lambda p: tell(p.iteration / max(p.of, 1)), **(patient.fit or {}))
        if estimate.reason.startswith("interrupted"):
            raise KeyboardInterrupt
        if estimate.invalid:
            raise PftwinError(estimate.sentence())
        return estimate

    def predict(self, patient: Patient, estimate: Estimate | None, tell: Tell) -> Dataset | None:
        """Outcomes of the cohort's treatments; None if it has none. Raises InputError as `fitting.predict` does, and if
        no variant could be simulated."""
        if not self.cohort.treatments:
            return None
        from fitting.prediction.plots import main_finding
        from fitting.prediction.predicting import predict
        from fitting.prediction.variants import combinations

        settings = dict(self.cohort.predict)
        if estimate is None:
            settings["samples"] = 0  # nothing is uncertain
        variants = [combinations(amounts) for amounts in self.cohort.treatments]
        scene = self._scene(patient)
        data = predict(scene, variants, estimate, progress=lambda done, of: tell(done / max(of, 1)), **settings)
        if bool(data["failed"].all()):
            raise InputError(main_finding(data), where=patient.name, remedy="pftwin simulate, which says more")
        return data

    def _scene(self, patient: Patient) -> Scene:
        if self._last is None or self._last[0] != patient:
            self._last = None  # frees the last scene before the next is loaded
            if patient.scene is None:
                from pftwin import rig

                assert patient.case is not None
                scene = rig.case(patient.case, contact=patient.contact or "P5")
            else:
                from pftwin.files.scene_file import load_scene

                own: dict[str, Any] = {"allow_outside": self.cohort.allow_outside, "limits": self.cohort.limits}
                scene = load_scene(patient.scene, contact=patient.contact, **own)
            self._last = patient, scene
        return self._last[1]


def run_cohort(
    cohort: Cohort,
    folder: str | os.PathLike[str] | None = None,
    *,
    resume: bool = False,
    work: Work | None = None,
    progress: Callable[[CohortProgress], None] | None = None,
) -> CohortReport:
    """Computes what a cohort's folder still lacks: fits, predictions, the summary, the manifest.

    Args:
        cohort: what to compute.
        folder: folder of the results; by default the cohort's own.
        resume: whether to continue if the folder already holds results. Units with the right key and checksum are kept,
            all others are computed. A folder without results is accepted either way.
        work: computes the units; by default with pftwin.
        progress: called while units run, and when they end.

    Returns:
        The outcome of each patient. Broken files, failed fits and a full disk are reported there
        and do not stop the other patients.

    Raises:
        InputError: the folder holds results and `resume` is false, or another process is using it.
        OutputError: the folder cannot be made or written to.
        MissingExtraError: pyarrow is not installed.
    """
    require_pyarrow()
    place = Path(cohort.output if folder is None else folder)
    with opened(place, cohort.name, resume=resume) as manifest:
        return _CohortRun(cohort, place, manifest, work or Work(cohort), progress or (lambda _: None)).run()


class _CohortRun:
    """One run over all patients."""

    def __init__(
        self, cohort: Cohort, folder: Path, manifest: Manifest, work: Work, tell: Callable[[CohortProgress], None]
    ) -> None:
        self.cohort, self.folder, self.manifest, self.work, self.tell = cohort, folder, manifest, work, tell
        self.outcomes = {p.name: PatientOutcome(p.name) for p in cohort.patients}
        self.report = CohortReport(folder, list(self.outcomes.values()))
        self.summary = SummaryFile(cohort, folder, manifest)

    def run(self) -> CohortReport:
        """Plans the units, runs those that are missing, and writes the summary after every patient."""
        began = time.perf_counter()
        missing = self._plan()
        self.pace = Pace(missing)
        for patient in self.cohort.patients:
            if units := [u for u in missing if u.patient == patient.name]:
                self._run_patient(patient, units)
                self._write_summary()
        for outcome in self.outcomes.values():
            outcome.status = "failed" if outcome.failure else "done"
        self._write_summary()
        self.report.seconds = time.perf_counter() - began
        return self.report

    def _plan(self) -> list[Unit]:
        """The units that are still to be computed."""
        missing: list[Unit] = []
        self.manifest.failures.clear()
        for patient in self.cohort.patients:
            outcome = self.outcomes[patient.name]
            with self._failures_recorded(outcome, "files"):
                units = units_of(self.cohort, patient)
                lacking = [u for u in units if not self.manifest.holds(u, self.folder)]
                if lacking and lacking[-1] is not units[-1]:
                    lacking.append(units[-1])  # a new fit requires new predictions
                outcome.kept = len(units) - len(lacking)
                missing += lacking
                if not lacking:
                    self._read_store(outcome, units[-1])
        return missing

    def _run_patient(self, patient: Patient, units: list[Unit]) -> None:
        """Runs a patient's units in turn until one fails."""
        outcome = self.outcomes[patient.name]
        for unit in units:
            with self._failures_recorded(outcome, unit.kind):
                self._run_unit(patient, unit)
                outcome.computed += 1
            with self._write_errors_reported("manifest"):
                self.manifest.save(self.folder)
            self.tell(self.pace.ended(unit, outcome.failure))
            if outcome.failure is not None:
                return
        with self._failures_recorded(outcome, "summary"):
            self._read_store(outcome, units[-1])

    def _read_store(self, outcome: PatientOutcome, unit: Unit) -> None:
        """Reads a completed patient's store. Raises InputError if it is not one."""
        self.summary.read(outcome.patient, unit)
        outcome.at_bounds = tuple(self.summary.rows[outcome.patient][0].get("at_bounds", "").split())

    def _run_unit(self, patient: Patient, unit: Unit) -> None:
        """Computes a unit, writes its file and records it in the manifest. Raises PftwinError if it cannot be computed
        or written."""
        began = time.perf_counter()
        self.pace.began(unit)
        self.tell(self.pace.progress(unit, 0.0))
        check_room(self.folder / PATIENTS)
        path, tell = self.folder / unit.file, lambda share: self.tell(self.pace.progress(unit, share))
        if unit.kind == "fit":
            estimate = self.work.fit(patient, tell)
            self._check_inputs(patient, unit)
            estimate.save(path)
        else:
            fitted = None  # read from its file, so that the prediction does not depend on which run made the fit
            if patient.fit is not None:
                from fitting.estimate import Estimate

                fitted = Estimate.load(self.folder / PATIENTS / f"{unit.patient}.fit.json")
            prediction = self.work.predict(patient, fitted, tell)
            about = self.work.scene_facts(patient)
            self._check_inputs(patient, unit)
            write_store(path, unit, about, fitted, prediction)
        self.manifest.record(unit, self.folder, time.perf_counter() - began)

    def _check_inputs(self, patient: Patient, unit: Unit) -> None:
        """Raises InputError if the input files changed during the computation."""
        if unit.key not in [u.key for u in units_of(self.cohort, patient)]:
            raise InputError("its files changed while it was computed", where=patient.name, remedy="--resume")

    def _write_summary(self) -> None:
        self.manifest.failures = {o.patient: o.failure for o in self.outcomes.values() if o.failure}
        with self._write_errors_reported("summary"):
            self.summary.write(self.manifest.failures)

    @contextmanager
    def _failures_recorded(self, outcome: PatientOutcome, stage: str) -> Iterator[None]:
        """Records a patient's failure; Ctrl-C is not caught."""
        try:
            yield
        except Exception as error:
            known = isinstance(error, PftwinError)
            text = None if known else traceback.format_exc()
            kind = type(error).__name__
            message = str(error) if known else f"unexpected error, a bug in pftwin: {kind}: {error}"
            outcome.failure = Failure(stage, kind, message, text)
            self.manifest.failures[outcome.patient] = outcome.failure

    @contextmanager
    def _write_errors_reported(self, what: str) -> Iterator[None]:
        """Reports why the manifest or the summary could not be written, unless a later write succeeds."""
        self.report.unwritten.pop(what, None)
        try:
            yield
        except (PftwinError, OSError) as error:
            self.report.unwritten[what] = str(error)
