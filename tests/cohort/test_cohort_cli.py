"""`pftwin cohort`: what it says and writes, its exit codes, and the whole way with real fits."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from cheap_cohort import CheapWork, write_cohort
from toy_scene_files import LIGHT, write_toy
from typer.testing import CliRunner, Result

from pftwin.cli import app
from pftwin.errors import InputError


def pftwin(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.fixture
def cheap_work(monkeypatch) -> CheapWork:
    work = CheapWork()
    monkeypatch.setattr("fitting.cohort.run.ByPftwin", lambda _: work)
    return work


def test_a_cohort_with_a_failure(tmp_path, cheap_work):
    cheap_work.broken["B", "fit"] = InputError("no sense", where="B.trc")
    file = write_cohort(tmp_path, 3)
    result = pftwin("cohort", file, "--json", "-")
    assert result.exit_code == 3, result.output
    said = json.loads(result.stdout)
    assert [p["status"] for p in said["patients"]] == ["done", "failed", "done"]
    assert said["files"] == [str(tmp_path / "cohort_results" / n) for n in ("manifest.json", "summary.parquet")]
    assert "cheap: 2 of 3 patients done in" in result.stderr
    assert "4 units computed, 0 were there" in result.stderr
    assert "B.trc: no sense" in result.stderr
    assert "flagged: 1 of 3 patients failed" in result.stderr
    assert "[1/6] A: fit: " in result.stderr
    assert "[3/6] B: fit: FAILED" in result.stderr.replace("[3/5]", "[3/6]")

    assert pftwin("cohort", file).exit_code == 2
    assert "--resume" in pftwin("cohort", file).stderr
    cheap_work.broken.clear()
    again = pftwin("cohort", file, "--resume")
    assert again.exit_code == 0, again.output
    assert "2 units computed, 4 were there" in again.stdout


def test_check(tmp_path, cheap_work):
    file, folder = write_cohort(tmp_path, 2), tmp_path / "elsewhere"
    assert pftwin("cohort", file, "--out", folder).exit_code == 0
    result = pftwin("cohort", file, "--out", folder, "--check")
    assert result.exit_code == 0, result.output
    assert "cheap: 5 of 5 files sound" in result.stdout
    (folder / "patients" / "A.nc").write_bytes(b"")
    (folder / "summary.parquet").write_bytes(b"no")
    result = pftwin("cohort", file, "--out", folder, "--check", "--json", tmp_path / "found.json")
    assert result.exit_code == 3
    assert "flagged: 2 files damaged, out of date or not there" in result.stderr
    assert "0 bytes in place of" in result.stdout
    found = {f["file"]: f["verdict"] for f in json.loads((tmp_path / "found.json").read_text())["files"]}
    assert (found["patients/A.nc"], found["summary.parquet"]) == ("damaged", "damaged")
    assert pftwin("cohort", file, "--out", folder, "--resume").exit_code == 0
    assert pftwin("cohort", file, "--out", folder, "--check").exit_code == 0


def test_check_of_nothing(tmp_path):
    result = pftwin("cohort", write_cohort(tmp_path, 1), "--check")
    assert result.exit_code == 2
    assert "manifest.json: no such file" in result.stderr


def test_a_mistake_in_the_file(tmp_path):
    file = write_cohort(tmp_path, 1)
    file.write_text(file.read_text().replace("free", "fre"))
    result = pftwin("cohort", file)
    assert result.exit_code == 2
    assert "did you mean free?" in result.stderr
    assert not (tmp_path / "cohort_results").exists()


def test_ctrl_c_says_what_is_saved(tmp_path, cheap_work):
    cheap_work.broken["B", "prediction"] = KeyboardInterrupt()
    result = pftwin("cohort", write_cohort(tmp_path, 2))
    assert result.exit_code == 130
    folder = tmp_path / "cohort_results"
    assert f"saved so far: {folder / 'manifest.json'}, {folder / 'summary.parquet'}" in result.stderr


MEASURED = '\n[measured]\npatella = { body = "patella" }\n'
REAL = """schema = 1

[fit]
free = ["K1"]
starts = 1

[predict]
samples = 2
dt_s = 5e-3

[[treatment]]
tibial_tuberosity_transfer = { medialisation_mm = [0, 5] }
"""


def write_real(folder: Path) -> Path:
    """Two knees that run, and four with something broken."""
    text = REAL
    for name in ("first", "second", "no_mesh", "no_toml", "nan_recording", "nothing_measured"):
        (folder / name).mkdir()
        write_toy(folder / name, LIGHT + MEASURED)
        text += f'\n[[patient]]\nname = "{name}"\nscene = "{name}/scene.toml"\n'
    scene = folder / "second" / "scene.toml"
    scene.write_text(scene.read_text().replace("stiffness_N_per_m = 156", "stiffness_N_per_m = 170"))
    scene = folder / "no_mesh" / "scene.toml"
    write_toy(folder / "no_mesh")
    (folder / "no_mesh" / "femur.stl").unlink()
    (folder / "no_toml" / "scene.toml").write_text("schema = ")
    (folder / "nothing_measured" / "scene.toml").write_text(LIGHT)
    poses = folder / "nan_recording" / "poses.csv"
    lines = poses.read_text().splitlines()
    lines[5:12] = [line.split(",")[0] + ",nan" * line.count(",") for line in lines[5:12]]
    poses.write_text("\n".join(lines) + "\n")
    (folder / "cohort.toml").write_text(text)
    return folder / "cohort.toml"


@pytest.mark.slow
def test_real_fits_beside_broken_files(tmp_path):
    file = write_real(tmp_path)
    result = pftwin("cohort", file, "--json", tmp_path / "said.json")
    assert result.exit_code == 3, result.output
    said = {p["patient"]: p for p in json.loads((tmp_path / "said.json").read_text())["patients"]}
    assert {n for n, p in said.items() if p["status"] == "done"} == {"first", "second"}
    why = {n: p["failure"]["message"] for n, p in said.items() if p["failure"]}
    assert "femur.stl" in why["no_mesh"]
    assert "not valid TOML" in why["no_toml"]
    assert "poses.csv" in why["nan_recording"]
    assert "nothing to compare with" in why["nothing_measured"]
    assert not any("unexpected" in words for words in why.values())

    pandas = pytest.importorskip("pandas")
    table = pandas.read_parquet(tmp_path / "cohort_results" / "summary.parquet")
    assert table.groupby("patient").size().to_dict() == dict.fromkeys(said, 1) | {"first": 2, "second": 2}
    done = table[table["status"] == "done"]
    assert (done["K1"] > 0).all()
    assert (done["peak_contact_force"] > 0).all()
    assert (done["peak_contact_force_low"] <= done["peak_contact_force_high"]).all()

    store = (tmp_path / "cohort_results" / "patients" / "first.nc").read_bytes()
    shutil.copy(tmp_path / "first" / "scene.toml", tmp_path / "no_toml" / "scene.toml")
    again = pftwin("cohort", file, "--resume", "--json", tmp_path / "said.json")
    assert again.exit_code == 3
    said = {p["patient"]: p for p in json.loads((tmp_path / "said.json").read_text())["patients"]}
    assert (said["first"]["kept"], said["no_toml"]["computed"]) == (2, 2)
    assert (tmp_path / "cohort_results" / "patients" / "first.nc").read_bytes() == store
