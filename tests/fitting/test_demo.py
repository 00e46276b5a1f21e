"""The whole of `pftwin demo`: what it leaves and says, and that the paper's section 2.6 meets its targets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fitting.demo.cases import CASES
from fitting.demo.paper_study import PATHOLOGY, simulated, with_springs
from fitting.demo.straight_springs import PATELLAR_TENDON, QUADRICEPS
from pftwin import rig
from pftwin.cli import app
from pftwin.dynamics.status import status_facts
from pftwin.files.result_files import load_dataset
from tests.benchmarks.fitting.plant import paper_objective

PUBLISHED = [156.0, 0.1432, 629.0, 0.0714]


@pytest.mark.slow
def test_a_natural_knee_before_and_after_a_transfer(tmp_path: Path):
    output, json_file = tmp_path / "demo", tmp_path / "demo.json"
    asked = ["demo", "--knee", "--out", str(output), "--json", str(json_file)]
    result = CliRunner().invoke(app, asked, env={"COLUMNS": "80"})
    assert result.exit_code == 0, result.output
    assert "SYNTHETIC" in result.output
    said = json.loads(json_file.read_text())
    assert all(Path(p).stat().st_size > 10_000 for p in said["files"])
    assert said["flexion_deg"] == [30, 60, 90]
    data = load_dataset(output / "after.nc")
    deepest = int(np.argmax(data["knee_flexion"].values))  # 90 deg, the last of the table
    rows = {row["quantity"]: row for row in said["table"]}
    assert rows["contact force, N"]["after"][2] == pytest.approx(float(data["contact_force"][deepest]), rel=1e-4)
    shift = rows["shift, mm"]
    assert shift["after"][2] == pytest.approx(1e3 * float(data["patella_shift"][deepest]), rel=1e-3)
    assert (np.subtract(shift["before"], shift["after"]) > 0.5).all()  # a medial tuberosity draws the patella medially
    assert said["synthetic"]
    assert said["doubts"] == []
    assert all(facts["status"] == "ok" for facts in said["status"].values())


def test_the_natural_knee_is_not_the_rig(tmp_path: Path):
    result = CliRunner().invoke(app, ["demo", "--knee", "--full", "--out", str(tmp_path / "demo")])
    assert result.exit_code == 2
    assert "--knee: given with --full" in result.output
    assert not (tmp_path / "demo").exists()


@pytest.mark.slow
def test_the_whole_demo(tmp_path: Path):
    output, json_file = tmp_path / "demo", tmp_path / "demo.json"
    result = CliRunner().invoke(app, ["demo", "--out", str(output), "--json", str(json_file)], env={"COLUMNS": "160"})
    assert result.exit_code == 0, result.output
    assert "SYNTHETIC" in result.output
    said = json.loads(json_file.read_text())
    assert all(Path(p).stat().st_size > 10_000 for p in said["figures"])
    assert {Path(p).stem for p in said["figures"]} >= {"case1", "case4", "pathology_fitted", "treatment_predicted"}
    for contact, cases in said["per_case"].items():
        for n, case in zip(CASES, cases, strict=True):
            flags = load_dataset(output / f"case{n}_{contact}.nc")["status"].values
            assert {k: case[k] for k in ("status", "status_frames")} == status_facts(flags)
    study = said["section_2_6"]
    table = {row["row"]: row for row in study["table2"]}
    assert table["mean distance"]["case1_by_paper"] <= 2.6  # [mm], as in the paper
    assert table["mean distance"]["case1_by_positions"] <= 0.6
    assert table["mean distance"]["case1_by_force"] <= 0.4
    assert all(row["as_measured"] is not False for row in study["outcomes"])
    by_paper = sum(table[f"{axis} RMSE"]["case2_by_paper"] for axis in "XYZ")
    lines = study["straight_lines"]
    nearest = [lines[name][what] for name in (QUADRICEPS, PATELLAR_TENDON) for what in ("stiffness", "slack_length")]
    by_lines, nominal = (
        paper_objective(simulated(PATHOLOGY, "", with_springs(rig.case(PATHOLOGY), theta)))
        for theta in (nearest, PUBLISHED)
    )
    assert by_paper < by_lines < nominal
    assert "was tuned to these figures" in said["notes"][0]
    assert "shares with the twin" in said["notes"][1]
    assert all(note in " ".join(result.output.split()) for note in said["notes"])
    for rows in (study["springs"][fit] for fit in ("positions", "force")):
        assert all("line" in row["covered"] for row in rows)
    fit = study["fits"]["paper"]
    at_bound = fit["values"][0] > 0.999 * 1.3 * PUBLISHED[0]  # K1, of springs that stiffen: steps are short there
    assert fit["reason"] == "converged" or at_bound
    np.testing.assert_allclose(fit["nominal"], PUBLISHED)
