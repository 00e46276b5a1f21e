"""`pftwin cohort`: what it says and writes, its exit codes, and the whole way with real fits."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from cheap_cohort import CheapWork, write_cohort
from made_estimates import made_estimate
from toy_scene_files import LIGHT, tibia_poses, write_poses, write_toy
from typer.testing import CliRunner, Result

from fitting import Estimate, predict
from fitting.cohort.manifest import Manifest
from fitting.cohort.summary import read_store
from fitting.parameters import Applied
from fitting.prediction.variants import grid
from pftwin import LinearImplicit, simulate
from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.mocap import PoseSeries
from pftwin.files.scene_file import load_scene

ROOT = Path(__file__).resolve().parents[3]


def pftwin(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.fixture
def cheap_work(monkeypatch) -> CheapWork:
    work = CheapWork()
    monkeypatch.setattr("fitting.cohort.run.Work", lambda _: work)
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
    assert "4 units computed, 0 up to date" in result.stderr
    assert "B.trc: no sense" in result.stderr
    assert "flagged: 1 of 3 patients failed" in result.stderr
    assert "[1/6] A: fit: " in result.stderr
    assert "[3/6] B: fit: FAILED" in result.stderr.replace("[3/5]", "[3/6]")

    assert pftwin("cohort", file).exit_code == 2
    assert "--resume" in pftwin("cohort", file).stderr
    cheap_work.broken.clear()
    again = pftwin("cohort", file, "--resume")
    assert again.exit_code == 0, again.output
    assert "2 units computed, 4 up to date" in again.stdout


def test_parameters_at_a_bound_are_listed(tmp_path, cheap_work):
    """In the table, in the JSON and on the terminal alike; of results of earlier runs as of computed ones."""
    parquet = pytest.importorskip("pyarrow.parquet")
    upper = {"A": [65.0, 0.1], "B": [70.0, 0.2]}

    def fit(patient, tell):
        return made_estimate({"K1": (65.0, 1.0), "L1": (0.1, 0.001)}, upper=np.array(upper[patient.name]))

    cheap_work.fit = fit
    file = write_cohort(tmp_path, 2)
    for more in ((), ("--resume",)):
        result = pftwin("cohort", file, *more, "--json", "-")
        assert result.exit_code == 0, result.output
        assert [p["at_bounds"] for p in json.loads(result.stdout)["patients"]] == [["K1", "L1"], []]
        assert "at a bound; the true value may lie beyond" in result.stderr
        assert re.search(r"A +\W K1, L1 ", result.stderr)
        table = parquet.read_table(tmp_path / "cohort_results" / "summary.parquet")
        assert table["at_bounds"].to_pylist() == ["K1 L1", "K1 L1", "", ""]


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
    assert "flagged: 2 files damaged, out of date or missing" in result.stderr
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

[[treatment]]
tibial_tuberosity_transfer = { medialisation_mm = [0, 5] }
"""


def record(folder: Path, stiffness: float) -> None:
    """Writes the motion of the folder's knee with another quadriceps [N/m] as its measured one."""
    scene = load_scene(folder / "scene.toml")
    result = simulate(scene.set("quadriceps.stiffness", stiffness), integrator=LinearImplicit(), dt=1 / 2400)
    patella = PoseSeries(result.times, result.position, result.quaternion)
    write_poses(folder / "poses.csv", {"tibia": tibia_poses(), "patella": patella})


def write_real(folder: Path) -> Path:
    """Two knees that run, and four with something broken."""
    text = REAL
    for name in ("first", "second", "no_mesh", "no_toml", "nan_recording", "nothing_measured"):
        (folder / name).mkdir()
        write_toy(folder / name, LIGHT + MEASURED)
        text += f'\n[[patient]]\nname = "{name}"\nscene = "{name}/scene.toml"\n'
    scene = folder / "second" / "scene.toml"
    scene.write_text(scene.read_text().replace("stiffness_N_per_m = 156", "stiffness_N_per_m = 170"))
    record(folder / "first", 163.0)
    record(folder / "second", 161.0)
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
def test_real_fits_beside_broken_files(tmp_path, monkeypatch):
    file, put_in, traced = write_real(tmp_path), [], []
    once = Applied.__call__

    def noted(self: Applied, *given: Any) -> Any:
        k1 = self.values[0]
        (traced if isinstance(k1, jax.core.Tracer) else put_in).append(k1)
        return once(self, *given)

    monkeypatch.setattr(Applied, "__call__", noted)
    result = pftwin("cohort", file, "--json", tmp_path / "said.json")
    assert result.exit_code == 3, result.output
    first, second = (Estimate.load(tmp_path / f"cohort_results/patients/{n}.fit.json") for n in ("first", "second"))
    assert first.values[0] == pytest.approx(163.0, rel=0.01)
    assert second.values[0] == pytest.approx(161.0, rel=0.01)
    # By each fit's verdict, by the check before a prediction, and for the starts of the estimate and its two draws,
    # which are alike here; the first patient's two programs (equilibrium and motion) serve the second.
    assert put_in.count(first.values[0]) == 2 + 3
    assert put_in.count(second.values[0]) == 2 + 3
    assert len(traced) == 2
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

    _, _, stored = read_store(tmp_path / "cohort_results" / "patients" / "second.nc")
    variants = grid("tibial_tuberosity_transfer", medialisation=[0, 0.005])
    alone = predict(load_scene(tmp_path / "second" / "scene.toml"), variants, second, samples=2)
    for name in ("peak_contact_force", "largest_offset", "mean_tilt", "parameters"):
        np.testing.assert_allclose(stored[name], alone[name], rtol=1e-9)

    store = (tmp_path / "cohort_results" / "patients" / "first.nc").read_bytes()
    shutil.copy(tmp_path / "first" / "scene.toml", tmp_path / "no_toml" / "scene.toml")
    again = pftwin("cohort", file, "--resume", "--json", tmp_path / "said.json")
    assert again.exit_code == 3
    said = {p["patient"]: p for p in json.loads((tmp_path / "said.json").read_text())["patients"]}
    assert (said["first"]["kept"], said["no_toml"]["computed"]) == (2, 2)
    assert (tmp_path / "cohort_results" / "patients" / "first.nc").read_bytes() == store


@pytest.mark.slow
def test_posteriors_by_simulations_with_nuisance(tmp_path):
    file = write_real(tmp_path)
    text = file.read_text().partition("[[patient]]")[0] + '[[patient]]\nname = "first"\nscene = "first/scene.toml"\n'
    fit = 'method = "simulations"\nsimulations = 1000\nrounds = 2\nnuisance = "friction=0.05"\n'
    file.write_text(re.sub(r"(?m)^starts = .*\n", "", text).replace("[fit]\n", f"[fit]\n{fit}"))
    result = pftwin("cohort", file)
    assert result.exit_code == 0, result.output
    found = Estimate.load(tmp_path / "cohort_results/patients/first.fit.json")
    assert found.auxiliary == ("contact.friction.coefficient",)
    assert found.draws is not None
    _, fitted, predicted = read_store(tmp_path / "cohort_results" / "patients" / "first.nc")
    assert fitted is not None
    assert fitted.attrs["auxiliary"] == "contact.friction.coefficient"
    assert predicted is not None
    drawn = {tuple(row) for row in found.draws[:, :2].round(9)}
    assert {tuple(row) for row in predicted["parameters"].values[1:, :2].round(9)} <= drawn


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_real_processes_killed(tmp_path):
    """As `test_cohort_kill` has it with cheap units: here compiled code runs, and threads of its own."""
    text = REAL
    for i in range(3):
        (tmp_path / f"P{i}").mkdir()
        scene = write_toy(tmp_path / f"P{i}", LIGHT + MEASURED)
        scene.write_text(scene.read_text().replace("stiffness_N_per_m = 156", f"stiffness_N_per_m = {150 + i}"))
        text += f'\n[[patient]]\nname = "P{i}"\nscene = "P{i}/scene.toml"\n'
    (tmp_path / "cohort.toml").write_text(text)
    patients, chance, finished = tmp_path / "cohort_results" / "patients", random.Random(3), {}
    program = [sys.executable, "-c", "from pftwin.cli import main; main()", "cohort", "cohort.toml", "--resume"]
    cache = os.environ.get("PFTWIN_TEST_CACHE", str(ROOT / ".jax_cache"))
    env = {**os.environ, "PYTHONPATH": str(ROOT), "PFTWIN_CACHE": cache, "NO_COLOR": "1"}
    for wanted in (1, 4):  # files that are there before the kill
        with subprocess.Popen(program, cwd=tmp_path, env=env, stderr=subprocess.PIPE, text=True) as process:
            while process.poll() is None and len([*patients.glob("P*")]) < wanted:
                time.sleep(0.02)
            time.sleep(chance.uniform(0, 0.3))
            process.kill()
        manifest = Manifest.load(tmp_path / "cohort_results")
        now = {name: (tmp_path / "cohort_results" / name).read_bytes() for name in manifest.files}
        assert len(now) >= wanted - 1
        assert all(now[name] == content for name, content in finished.items())
        finished = now
    ended = subprocess.run(program, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert f"{6 - len(finished)} units computed, {len(finished)} up to date" in ended.stdout
    assert pftwin("cohort", tmp_path / "cohort.toml", "--check").exit_code == 0
