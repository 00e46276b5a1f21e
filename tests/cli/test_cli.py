"""The command line: what it writes, says, and refuses."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import pftwin, refused
from toy_scene_files import SCENE, write_toy

from pftwin.base.errors import InputError
from pftwin.dynamics.status import Status
from pftwin.files.result_files import load_dataset
from pftwin.geometry.mesh.mesh import save_mesh
from pftwin.geometry.patch.implant import rig_implant
from pftwin.model.scene import Scene

MEASURED = """
[measured]
patella = { body = "patella" }
forces = "forces.csv"
contact_force = "contact"
"""
STEP = ("--dt", "0.005")  # one step for all tests: one program to compile
COMMANDS = (
    *("demo", "simulate", "equilibrium", "validate", "fit-surface", "doctor-mesh"),
    *("init", "fit", "treat", "optimise", "plan-experiment", "explain", "audit"),
)


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("toy")
    scene = write_toy(folder, SCENE + MEASURED)
    rows = [f"{0.005 * i:.3f},{8 + 0.05 * i}" for i in range(81)]
    (folder / "forces.csv").write_text("\n".join(["time_s,contact_N", *rows]) + "\n")
    return scene


def test_simulate_writes_the_result_in_three_formats(toy: Path, tmp_path: Path) -> None:
    result = pftwin("simulate", toy, "-o", tmp_path / "out.nc", "--csv", "--sto", "--json", tmp_path / "o.json", *STEP)
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["o.json", "out.csv", "out.nc", "out.sto"]
    assert "toy: 41 frames, 0.40 s" in result.stdout
    assert "R^2 99." in result.stderr
    facts = json.loads((tmp_path / "o.json").read_text())
    assert facts["settings"] == {"integrator": "linear_implicit_bdf2", "dt_s": 0.005, "substeps": 2}
    assert facts["frames"] == 41
    assert facts["contact"] == "P5"
    assert facts["equilibrium"]["converged"]
    assert facts["dtype"] == "float64"
    assert facts["files"] == [str(tmp_path / f"out.{k}") for k in ("nc", "csv", "sto")]
    assert facts["timing"]["run_s"] <= facts["timing"]["first_run_s"]
    data = load_dataset(tmp_path / "out.nc")
    assert data.sizes["time"] == 41
    assert 0 < facts["estimated_error"]["path_m"] == data["estimated_error_path"].values.max() < 1e-3
    assert facts["estimated_error"]["contact_force_N"] == data["estimated_error_contact_force"].values.max()
    assert sorted(facts["estimated_error"]) == ["contact_force_N", "lateral_facet_N", "medial_facet_N", "path_m"]


def test_json_on_stdout_is_json_alone(toy: Path) -> None:
    result = pftwin("equilibrium", toy, "--json", "-")
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    assert facts["scene"] == "toy"
    assert facts["residual_N"] < 1e-6
    assert facts["effects"]["contact"]["indentation_medial"] is None or facts["facets"] == ["medial", "lateral"]
    assert "toy: stable equilibrium" in result.stderr
    assert "residual [N]" in result.stderr
    assert "patella in the femur [mm]" in result.stderr


def test_equilibrium_shows_observables_with_their_units() -> None:
    """As JSON has them in N and m: forces in N, lengths in mm; no number where a facet is not loaded."""
    result = pftwin("equilibrium", "--case", 2, "--json", "-")
    assert result.exit_code == 0, result.output
    seen = json.loads(result.stdout)["effects"]
    rows = {c[1].strip(): c[2].strip() for line in result.stderr.splitlines() if len(c := line.split("│")) == 4}
    force, length = rows["contact force"].split(), rows["patellar tendon length"].split()
    assert (float(force[0]), force[1]) == (pytest.approx(seen["contact"]["force"], rel=1e-4), "N")
    assert (float(length[0]), length[1]) == (pytest.approx(1e3 * seen["patellar_tendon"]["length"], rel=1e-4), "mm")
    assert seen["contact"]["indentation_medial"] is None
    assert rows["contact indentation medial"] == "none"


def test_validate_shows_the_papers_values_beside_the_rigs_cases(tmp_path: Path) -> None:
    result = pftwin("validate", "--case", 1, "--json", tmp_path / "o.json", "--dt", "0.002")
    assert result.exit_code == 0, result.output
    assert "paper, P5" in result.stdout
    assert "tibial spring RMSE" in result.stdout
    by_key = {row["key"]: row for row in json.loads((tmp_path / "o.json").read_text())["rows"]}
    assert by_key["contact_force"]["paper"] == 3.33


def test_validate_shows_the_rows_of_table_1(toy: Path, tmp_path: Path) -> None:
    """Of a knee that is not the rig's, without the paper's values, and with the names of its own tendons."""
    result = pftwin("validate", toy, "-o", tmp_path / "o.nc", "--json", tmp_path / "o.json", *STEP)
    assert result.exit_code == 0, result.output
    assert "paper" not in result.stdout
    assert "spring" not in result.stdout
    assert "patellar tendon force RMSE" in result.stdout
    assert "quadriceps force RMSE" in result.stdout
    facts = json.loads((tmp_path / "o.json").read_text())
    assert facts["files"] == [str(tmp_path / "o.nc")]
    assert load_dataset(tmp_path / "o.nc").sizes["time"] == 41
    assert [row["key"] for row in facts["rows"]][:2] == ["contact_force", "tibial_spring"]
    by_key = {row["key"]: row for row in facts["rows"]}
    assert by_key["contact_force"]["paper"] is None
    assert by_key["tibial_spring"]["value"] is None
    assert by_key["mean_distance"]["value"] == pytest.approx(facts["mean_distance"])
    assert 5 < facts["mean_distance"] < 30  # the toy's "recorded" patella stays where it was put
    assert facts["frames_compared"] == 41
    assert facts["side_as_given"] == ""
    assert "taken as given" not in result.output
    left = toy.with_name("left.toml")
    left.write_text(toy.read_text().replace("schema = 1", 'schema = 1\nside = "left"'))
    result = pftwin("validate", left, "--json", tmp_path / "o.json", *STEP)
    said = json.loads((tmp_path / "o.json").read_text())["side_as_given"]
    assert said.startswith('side = "left" is taken as given')
    assert " ".join(result.output.split()).count(said) == 1


@pytest.mark.parametrize("command", ["simulate", "equilibrium", "validate"])
def test_why_a_motion_is_invalid_is_said_once(toy: Path, tmp_path: Path, command: str) -> None:
    """The equilibrium is farther from the start of the file than a limit allows."""
    options = {"simulate": ("-o", tmp_path / "o.nc", *STEP), "equilibrium": (), "validate": STEP}[command]
    result = pftwin("--allow", "most_start_turn_deg=0.001", command, toy, *options)
    assert result.exit_code == 3, result.output
    assert result.stdout.startswith("INVALID: the equilibrium is ")
    assert " ".join(result.output.split()).count("most_start_turn_deg") == 1
    assert "flagged: toy is INVALID" in result.stderr


def test_validate_doubts_forces_in_another_unit(toy: Path, tmp_path: Path) -> None:
    """A contact force of some 20 N in a column of kilonewtons: the doubt comes first, and the exit code is 3."""
    rows = "".join(f"{0.01 * k:.2f},{20 + k / 10:.1f}\n" for k in range(41))
    toy.with_name("kilonewtons.csv").write_text(f"time_s,contact_kN\n{rows}")
    scene = toy.with_name("kilonewtons.toml")
    scene.write_text(toy.read_text().replace("forces.csv", "kilonewtons.csv"))
    result = pftwin("validate", scene, "--json", tmp_path / "o.json", *STEP)
    assert result.exit_code == 3, result.output
    assert result.stdout.startswith("the measured contact force has 2.2e+04 N rms, the simulated one ")
    assert "check its unit and channel" in result.stderr
    assert json.loads((tmp_path / "o.json").read_text())["doubts"]


def test_an_equilibrium_far_from_the_start_is_as_invalid_as_a_motion_from_there(toy: Path, tmp_path: Path) -> None:
    strict = ("--allow", "most_start_shift_mm=0.01")
    options = {"equilibrium": (), "simulate": ("-o", tmp_path / "o.nc", *STEP)}
    found = [pftwin(*strict, command, toy, "--json", "-", *more) for command, more in options.items()]
    assert [r.exit_code for r in found] == [3, 3]
    alone, motion = (json.loads(r.stdout)["verdict"] for r in found)
    assert alone.startswith("INVALID: ")
    reason = next(r for r in alone.removeprefix("INVALID: ").split("; ") if r.startswith("the equilibrium is "))
    assert reason in motion


def test_every_command_that_runs_a_scene_says_the_same_of_trust(toy: Path, tmp_path: Path) -> None:
    """Each flag by name with its frames, none left out: a patella that lifts off has frames without contact."""
    said = {}
    for command in ("simulate", "validate", "equilibrium"):
        options = {"simulate": ("-o", tmp_path / "o.nc", *STEP), "validate": STEP, "equilibrium": ()}[command]
        said[command] = json.loads(pftwin(command, toy, "--json", "-", *options).stdout)
    flags = [str(f.name).lower() for f in Status if f]
    for facts in said.values():
        assert list(facts["status_frames"]) == flags
        assert (facts["status"] == "ok") == (not any(facts["status_frames"].values()))
    assert {facts["verdict"] for facts in said.values()} == {"valid"}
    assert set(said["simulate"]) <= set(said["validate"])
    assert said["simulate"]["status_frames"] == said["validate"]["status_frames"]
    data = load_dataset(tmp_path / "o.nc")
    for flag in Status:
        if flag:
            count = int(np.count_nonzero(data["status"].values & int(flag)))
            assert said["simulate"]["status_frames"][str(flag.name).lower()] == count


def test_another_polynomial_can_be_asked_for(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def solve(scene: Scene) -> None:
        raise InputError(f"a polynomial of degree {scene.contact.surface.degree}")

    monkeypatch.setattr("pftwin.dynamics.simulate.equilibrium", solve)
    assert "a polynomial of degree 4" in refused("equilibrium", toy, "--contact", "p4")
    assert "no contact 'Q4'" in refused("equilibrium", toy, "--contact", "Q4")


def test_fit_surface(toy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)  # what another test has imported
    figure = tmp_path / "region.png"
    mesh = tmp_path / "femur.stl"
    save_mesh(rig_implant().mesh(deviation=0.03e-3), mesh)
    result = pftwin("fit-surface", mesh, "--units", "m", "-o", figure, "--json", "-", "--angles-deg", -75, 30)
    assert result.exit_code == 0, result.output
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "matplotlib.pyplot" not in sys.modules  # nor its choice of a backend for the whole process
    facts = json.loads(result.stdout)
    assert [f["polynomial"] for f in facts["fits"]] == ["P2", "P4", "P5"]
    r_squared = [f["r_squared"] for f in facts["fits"]]
    assert 0.85 < r_squared[0] < r_squared[1] < r_squared[2] < 1
    assert len(facts["fits"][1]["coefficients_m"]) == 15
    assert "P4" in result.stderr
    assert "rms [mm]" in result.stderr


def test_fit_surface_names_the_axes_along_which_there_is_a_groove(tmp_path: Path) -> None:
    mesh = tmp_path / "femur.stl"
    save_mesh(rig_implant().mesh(deviation=0.03e-3), mesh)
    said = refused("fit-surface", mesh, "--units", "m", "--anterior=-x", "--proximal=+y")
    assert "try: --anterior=+z --proximal=+x" in said
    assert "anterior=," not in said


def test_fit_surface_refuses(toy: Path, tmp_path: Path) -> None:
    mesh = toy.parent / "femur.stl"
    assert "femurs.stl: no such file" in refused("fit-surface", tmp_path / "femurs.stl", "--units", "m")
    assert "implausible" in refused("fit-surface", mesh, "--units", "mm")
    assert "unknown length unit 'furlong'" in refused("fit-surface", mesh, "--units", "furlong")
    assert "no polynomial 'P99'" in refused("fit-surface", mesh, "--units", "m", "--degree", "P2,P99")
    nowhere = ("fit-surface", tmp_path / "femurs.stl", "--units", "m")  # amounts are read before the mesh
    assert "--half-width: found '3N'" in refused(*nowhere, "--half-width", "3N")
    assert "--half-width: found '-3 mm'" in refused(*nowhere, "--half-width", "-3 mm")
    assert "--tolerance: found '-1 mm'" in refused(*nowhere, "--kind", "spline", "--tolerance", "-1 mm")
    assert "--chart: no chart 'cone'" in refused("fit-surface", mesh, "--units", "m", "--chart", "cone")
    assert "--anterior: found 'up'" in refused("fit-surface", mesh, "--units", "m", "--anterior", "up")
    bad_figure = refused("fit-surface", mesh, "--units", "m", "-o", tmp_path / "a.gif")
    assert "unknown kind of figure; expected: .png, .svg, .pdf" in bad_figure
    assert not list(tmp_path.iterdir())


def test_outputs_are_checked_before_the_work(toy: Path, tmp_path: Path) -> None:
    """The scene named here does not even exist: the output's place is refused first."""
    none = tmp_path / "none.toml"
    assert "there is no folder" in refused("simulate", none, "-o", tmp_path / "missing" / "out.nc")
    assert "results are NetCDF; try: " in refused("simulate", none, "-o", tmp_path / "out.mat")
    assert "there is no folder" in refused("validate", none, "--json", tmp_path / "missing" / "o.json")
    assert "two outputs would go to this file" in refused(
        "simulate", none, "-o", tmp_path / "o.nc", "--csv", "--json", tmp_path / "o.csv"
    )
    (tmp_path / "folder.nc").mkdir()
    assert "is a folder" in refused("equilibrium", none, "--json", tmp_path / "folder.nc")
    (tmp_path / "file").write_text("")
    assert "is a file; try: another name" in refused("demo", "--out", tmp_path / "file")
    assert "is a file; try: another name" in refused("init", tmp_path / "file")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.nc"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc: nowhere that even root cannot write")
def test_a_folder_that_takes_no_files_is_refused() -> None:
    assert "/proc/out.nc: cannot be written" in refused("simulate", "none.toml", "-o", "/proc/out.nc")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="permissions do not bind this user")
def test_a_folder_without_permission_is_refused(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir()
    closed.chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert "permission denied" in refused("simulate", "none.toml", "-o", closed / "out.nc")
    assert "no permission to write" in refused("init", closed / "new")


def test_bad_input_is_one_message_and_nothing_is_written(toy: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(SCENE.replace("mass_kg = 0.12", "mass_kg = -1"))
    message = refused("simulate", tmp_path / "bad.toml", "-o", tmp_path / "out.nc")
    assert "bad.toml, line 12, [patella] mass_kg: found -1; expected: a positive number" in message
    assert "none.toml: no such file" in refused("simulate", tmp_path / "none.toml", "-o", tmp_path / "out.nc")
    assert "integrator: no integrator 'euler'" in refused(
        "simulate", toy, "-o", tmp_path / "out.nc", "--integrator", "euler"
    )
    assert "dt: found -1.0" in refused("simulate", toy, "-o", tmp_path / "out.nc", "--dt", -1)
    assert [p.name for p in tmp_path.iterdir()] == ["bad.toml"]


def test_one_scene_is_needed(toy: Path) -> None:
    assert "neither a scene file nor --case given" in refused("equilibrium")
    assert "both a scene file and --case given" in refused("equilibrium", toy, "--case", 1)
    assert "both --case and --knee given" in refused("equilibrium", "--case", 1, "--knee", "B")


def test_the_natural_knee_has_one_contact() -> None:
    assert "--knee: found 'E'; expected: one of: normal, A, B, C, D" in refused("equilibrium", "--knee", "E")
    assert "--activity: given without --knee" in refused("equilibrium", "--case", 1, "--activity", "squat")
    message = refused("equilibrium", "--knee", "normal", "--activity", "walk")
    assert "activity: found 'walk'; expected: one of: squat, extension" in message
    assert "--contact: given with --knee" in refused("equilibrium", "--knee", "normal", "--contact", "P5")


@pytest.mark.slow
def test_the_natural_knee_finds_its_equilibrium(tmp_path: Path) -> None:
    result = pftwin("equilibrium", "--knee", "B", "--json", tmp_path / "o.json")
    assert result.exit_code == 0, result.output
    facts = json.loads((tmp_path / "o.json").read_text())
    assert facts["converged"]


def test_validate_needs_measurements(toy: Path) -> None:
    bare = toy.with_name("bare.toml")
    bare.write_text(SCENE)
    assert "expected: a table [measured] in the scene file" in refused("validate", bare)


def test_mistakes_of_our_own_are_not_swallowed(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("pftwin.dynamics.simulate.equilibrium", broken)
    assert isinstance(pftwin("equilibrium", toy).exception, ZeroDivisionError)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command: str) -> None:
    result = pftwin(command, "--help")
    assert result.exit_code == 0
    assert f"Example: pftwin {command}" in " ".join(result.stdout.split())
    assert "--json" in result.stdout


def test_json_keeps_to_the_standard(tmp_path: Path) -> None:
    from pftwin.cli.terminal import write_json

    write_json({"a": np.array([1.0, np.nan]), "b": float("inf"), "c": (1, None)}, str(tmp_path / "a.json"))
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [1.0, None], "b": None, "c": [1, None]}


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-c", "from pftwin.cli import main; main()", *(str(a) for a in arguments)]
    root = str(Path(__file__).resolve().parents[2])
    return subprocess.run(
        program, cwd=cwd, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": root}
    )


def test_the_program_answers_without_loading_jax(tmp_path: Path) -> None:
    heavy = ("jax", "numpy", "pydantic", "matplotlib", "jinja2")
    code = f"import sys, pftwin.cli.program; sys.exit(any(m in sys.modules for m in {heavy}))"
    root = str(Path(__file__).resolve().parents[2])
    env = {**os.environ, "PYTHONPATH": root}
    assert subprocess.run([sys.executable, "-c", code], env=env, cwd=tmp_path, check=False).returncode == 0


def test_the_program_itself(toy: Path, tmp_path: Path) -> None:
    done = run("simulate", tmp_path / "none.toml", "-o", "out.nc", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
