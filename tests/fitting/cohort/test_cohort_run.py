"""A cohort's folder: what is written, what stays, what is computed anew, and what stops nobody."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from cheap_cohort import HEAD, CheapWork, cheap, write_cohort

from fitting.cohort import read_cohort, run_cohort
from fitting.cohort.folder import check_cohort, opened
from fitting.cohort.run import Work
from fitting.cohort.summary import read_store
from fitting.estimate import Estimate
from pftwin.base.errors import InputError, OutputError

BOTH = ["fit", "prediction"]


def units(*patients: str) -> list[tuple[str, str]]:
    return [(p, kind) for p in patients for kind in BOTH]


def verdicts(cohort) -> dict[str, str]:
    return {f.file: f.verdict for f in check_cohort(cohort)}


def test_a_run_writes_stores_estimates_summary_and_manifest(tmp_path):
    cohort, work = cheap(tmp_path), CheapWork()
    report = run_cohort(cohort, work=work)
    assert report.sound
    assert work.ran == units("A", "B", "C")
    folder = tmp_path / "cohort_results"
    assert report.folder == folder
    assert {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} == {
        ".lock",
        "manifest.json",
        "summary.parquet",
        *(f"patients/{name}{ending}" for name in "ABC" for ending in (".fit.json", ".nc")),
    }
    assert set(verdicts(cohort).values()) == {"sound"}
    assert len(verdicts(cohort)) == 7
    about, fit, prediction = read_store(folder / "patients" / "B.nc")
    assert about["patient"] == "B"
    assert fit is not None
    assert prediction is not None
    estimate = Estimate.load(folder / "patients" / "B.fit.json")
    assert fit["value"].values.tolist() == estimate.values.tolist() == [66.0, 0.1]
    assert fit["low"].values.tolist() == estimate.intervals[:, 0].tolist()
    assert prediction["peak_contact_force"].values[:, 0].tolist() == [66.0, 76.0]


def test_nothing_is_computed_twice(tmp_path):
    cohort = cheap(tmp_path)
    run_cohort(cohort, work=CheapWork())
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in (tmp_path / "cohort_results/patients").iterdir()}
    summary = (tmp_path / "cohort_results/summary.parquet").stat().st_mtime_ns
    again = CheapWork()
    report = run_cohort(cohort, resume=True, work=again)
    assert again.ran == []
    assert [o.kept for o in report.outcomes] == [2, 2, 2]
    assert before == {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in before}
    assert (tmp_path / "cohort_results/summary.parquet").stat().st_mtime_ns == summary


def test_what_changed_is_computed_anew(tmp_path):
    run_cohort(cheap(tmp_path, 2), work=CheapWork())
    (tmp_path / "B.toml").write_text("mass = 7\n")
    assert verdicts(read_cohort(tmp_path / "cohort.toml"))["patients/B.nc"] == "out of date"
    work = CheapWork()
    run_cohort(read_cohort(tmp_path / "cohort.toml"), resume=True, work=work)
    assert work.ran == units("B")  # a scene file

    text = (tmp_path / "cohort.toml").read_text()
    (tmp_path / "cohort.toml").write_text(text.replace("samples = 2", "samples = 3"))
    work = CheapWork()
    run_cohort(read_cohort(tmp_path / "cohort.toml"), resume=True, work=work)
    assert work.ran == [(p, "prediction") for p in "AB"]  # a setting of predictions

    (tmp_path / "cohort_results/patients/B.nc").write_bytes(b"not what was written")
    assert verdicts(read_cohort(tmp_path / "cohort.toml"))["patients/B.nc"] == "damaged"
    work = CheapWork()
    run_cohort(read_cohort(tmp_path / "cohort.toml"), resume=True, work=work)
    assert work.ran == [("B", "prediction")]


def test_a_file_that_a_scene_names_is_part_of_the_key(tmp_path):
    cohort = cheap(tmp_path, 2)
    (tmp_path / "walk.csv").write_text("1")
    (tmp_path / "A.toml").write_text('poses = "walk.csv"\n')
    run_cohort(cohort, work=CheapWork())
    (tmp_path / "walk.csv").write_text("2")
    work = CheapWork()
    run_cohort(cohort, resume=True, work=work)
    assert work.ran == units("A")


def test_another_version_computes_anew(tmp_path, monkeypatch):
    cohort = cheap(tmp_path, 1)
    run_cohort(cohort, work=CheapWork())
    monkeypatch.setattr("fitting.cohort.manifest.versions", lambda: {"pftwin": "99"})
    work = CheapWork()
    run_cohort(cohort, resume=True, work=work)
    assert work.ran == units("A")


def test_keys_do_not_know_where_the_cohort_lies(tmp_path):
    keys = []
    for place in ("here", "there"):
        (tmp_path / place).mkdir()
        cohort = cheap(tmp_path / place, 1)
        run_cohort(cohort, work=CheapWork())
        manifest = json.loads((cohort.output / "manifest.json").read_text())
        keys.append({name: entry["key"] for name, entry in manifest["files"].items()})
    assert keys[0] == keys[1]
    assert len(keys[0]) == 2


def test_failures_are_reported_and_stop_nobody(tmp_path):
    cohort = cheap(tmp_path, 5)
    (tmp_path / "A.toml").write_text("mass = ")
    (tmp_path / "B.toml").unlink()
    work = CheapWork(
        broken={("C", "fit"): InputError("no sense", where="C.trc"), ("D", "prediction"): ZeroDivisionError("oh")}
    )
    report = run_cohort(cohort, work=work)
    assert [o.status for o in report.outcomes] == ["failed"] * 4 + ["done"]
    a, b, c, d = (o.failure for o in report.outcomes[:4])
    assert (a.stage, b.stage, c.stage, d.stage) == ("files", "files", "fit", "prediction")
    assert "not valid TOML" in a.message
    assert "no such file" in b.message
    assert c.message == "C.trc: no sense"
    assert d.message == "unexpected error, a bug in pftwin: ZeroDivisionError: oh"
    assert "Traceback" in d.traceback
    assert c.traceback is None
    manifest = json.loads((cohort.output / "manifest.json").read_text())
    assert set(manifest["failures"]) == set("ABCD")
    assert set(manifest["files"]) == {"patients/D.fit.json", "patients/E.fit.json", "patients/E.nc"}
    found = verdicts(cohort)
    assert (found["B"], found["patients/C.fit.json"], found["patients/D.fit.json"]) == (
        "not there yet",
        "not there yet",
        "sound",
    )

    write_cohort(tmp_path, 5)  # mended
    work = CheapWork()
    assert run_cohort(cohort, resume=True, work=work).sound
    assert work.ran == [*units("A", "B", "C"), ("D", "prediction")]
    assert json.loads((cohort.output / "manifest.json").read_text())["failures"] == {}


def test_files_that_change_under_a_unit(tmp_path):
    cohort = cheap(tmp_path, 2)
    work = CheapWork(began=lambda p, k: (tmp_path / "A.toml").write_text("x = 1") if (p, k) == ("A", "fit") else None)
    report = run_cohort(cohort, work=work)
    assert [o.status for o in report.outcomes] == ["failed", "done"]
    assert "its files changed while it was computed" in report.outcomes[0].failure.message
    assert not (cohort.output / "patients/A.fit.json").exists()


def test_without_resume_results_are_left_alone(tmp_path):
    cohort = cheap(tmp_path, 1)
    run_cohort(cohort, work=CheapWork())
    with pytest.raises(InputError, match=r"holds results of this cohort already: 2 finished files; try: --resume"):
        run_cohort(cohort, work=CheapWork())


def test_another_cohorts_folder(tmp_path):
    run_cohort(cheap(tmp_path, 1), work=CheapWork())
    other = cheap(tmp_path, 1, HEAD.replace('"cheap"', '"dear"'))
    with pytest.raises(InputError, match="holds results of the cohort 'cheap'; expected: those of 'dear'"):
        run_cohort(other, resume=True, work=CheapWork())


def test_a_folder_that_no_cohort_made(tmp_path):
    (tmp_path / "mine" / "patients").mkdir(parents=True)
    with pytest.raises(InputError, match=r"mine: holds patients and no manifest\.json"):
        run_cohort(cheap(tmp_path, 1), tmp_path / "mine", resume=True, work=CheapWork())


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"format": "other"}', '{"format": "pftwin cohort manifest 1", "files": 3}']
)
def test_a_damaged_manifest(tmp_path, content):
    cohort = cheap(tmp_path, 1)
    run_cohort(cohort, work=CheapWork())
    (cohort.output / "manifest.json").write_text(content)
    with pytest.raises(InputError, match=r"manifest\.json.*(no manifest|not valid JSON)"):
        run_cohort(cohort, resume=True, work=CheapWork())


def test_a_damaged_entry_is_named(tmp_path):
    cohort = cheap(tmp_path, 1)
    run_cohort(cohort, work=CheapWork())
    path = cohort.output / "manifest.json"
    path.write_text(path.read_text().replace('"bytes": ', '"later": 1, "bytes": "x", "bytes_then": '))
    with pytest.raises(InputError, match=r"no manifest: 'files', 'patients/A.*', 'bytes': Input should be .* integer"):
        check_cohort(cohort)
    path.write_text(path.read_text().replace('"bytes": "x", "bytes_then": ', '"bytes": '))  # with a field of later
    assert check_cohort(cohort)


def test_a_manifest_names_files_in_its_folder_alone(tmp_path):
    cohort = cheap(tmp_path, 1)
    run_cohort(cohort, work=CheapWork())
    path = cohort.output / "manifest.json"
    path.write_text(path.read_text().replace("patients/A.nc", "patients/../../cohort.toml"))
    with pytest.raises(InputError, match=r"it names the file 'patients/\.\./\.\./cohort\.toml'"):
        check_cohort(cohort)


def test_two_processes_at_once(tmp_path):
    cohort = cheap(tmp_path, 1)
    with (
        opened(cohort.output, cohort.name, resume=False),
        pytest.raises(InputError, match="another process works on this cohort"),
    ):
        run_cohort(cohort, resume=True, work=CheapWork())
    assert run_cohort(cohort, resume=True, work=CheapWork()).sound


def test_places_that_cannot_be(tmp_path):
    cohort = cheap(tmp_path, 1)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="is a file; try: another folder"):
        run_cohort(cohort, tmp_path / "file", work=CheapWork())
    with pytest.raises(OutputError, match=r"there is no folder .*none; try: create it first"):
        run_cohort(cohort, tmp_path / "none" / "out", work=CheapWork())
    with pytest.raises(OutputError, match="cannot be made"):
        run_cohort(cohort, tmp_path / "file" / "out", work=CheapWork())


def test_files_of_a_patient_who_was_removed_stay(tmp_path):
    run_cohort(cheap(tmp_path, 2), work=CheapWork())
    smaller = cheap(tmp_path, 1)
    assert run_cohort(smaller, resume=True, work=CheapWork()).sound
    assert verdicts(smaller)["patients/B.nc"] == "no longer in the list"


def test_ctrl_c_keeps_the_units_that_are_done(tmp_path):
    cohort = cheap(tmp_path, 2)
    with pytest.raises(KeyboardInterrupt):
        run_cohort(cohort, work=CheapWork(broken={("B", "fit"): KeyboardInterrupt()}))
    work = CheapWork()
    run_cohort(cohort, resume=True, work=work)
    assert work.ran == units("B")


def test_progress_and_time_left(tmp_path, monkeypatch):
    reports, clock = [], [0.0]
    monkeypatch.setattr("fitting.cohort.report.time", SimpleNamespace(perf_counter=lambda: clock[0]))

    def began(patient: str, _: str) -> None:
        clock[0] += 1000.0 if patient == "B" else 10.0

    cohort = cheap(tmp_path, 3)
    work = CheapWork(began=began, broken={("B", "fit"): InputError("no")})
    run_cohort(cohort, work=work, progress=reports.append)
    ended = [p for p in reports if p.ended]
    assert [(p.unit.patient, p.unit.kind) for p in ended] == [*units("A"), ("B", "fit"), *units("C")]
    assert [(p.number, p.of) for p in ended] == [(1, 6), (2, 6), (3, 5), (4, 5), (5, 5)]
    # A's fit 10 s, its prediction 10 s; two fits and predictions are to come. A failure's time does not count.
    assert [p.left for p in ended] == [50.0, 40.0, 20.0, 10.0, 0.0]
    assert ended[2].failure is not None
    assert reports[0].left is None
    assert [p.left for p in reports if p.share == 0.5] == [None, 10.0]  # a unit of 10 s that has run for 10 s


def test_a_chosen_folder(tmp_path):
    head = HEAD.replace('name = "cheap"', 'name = "cheap"\noutput = "mine"')
    run_cohort(cheap(tmp_path, 1, head), work=CheapWork())
    assert (tmp_path / "mine/manifest.json").is_file()


@pytest.mark.parametrize("failed", [[False, True], [True, True]])
def test_predictions_of_which_none_could_be_simulated_are_refused(tmp_path, monkeypatch, failed):
    """By the real work, with outcomes in the place of simulations."""
    import xarray

    cohort = cheap(tmp_path, 1)
    outcomes = xarray.Dataset({"failed": ("variant", np.array(failed))}, attrs={"objection": "INVALID: no knee moves"})
    monkeypatch.setattr("fitting.prediction.predicting.predict", lambda *_, **__: outcomes)
    work = Work(cohort)
    monkeypatch.setattr(work, "_scene", lambda patient: None)
    if all(failed):
        with pytest.raises(InputError, match="no knee moves"):
            work.predict(cohort.patients[0], None, lambda share: None)
    else:
        assert work.predict(cohort.patients[0], None, lambda share: None) is outcomes
