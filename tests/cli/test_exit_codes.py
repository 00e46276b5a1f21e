"""One exit code for one kind of end, whichever command it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from commands import pftwin

from pftwin.base.errors import InputError, MissingExtraError, OutputError, PftwinError
from pftwin.cli.exit_codes import ExitCode, Interrupted, check_trust_of_files, code_of, report_written_on_interrupt
from pftwin.geometry.mesh.mesh import SurfaceMesh, save_mesh
from pftwin.results.verdict import Verdict

PAGE = Path(__file__).resolve().parents[2] / "docs" / "command_line.md"


def test_errors_about_input_and_about_outcomes_differ():
    missing = MissingExtraError("k3d", extra="viewer", feature="drawing")
    assert {code_of(e) for e in (InputError("x"), OutputError("x"), missing)} == {ExitCode.BAD_INPUT}
    assert code_of(PftwinError("x")) == ExitCode.FLAGGED


def test_usage_is_code_2():
    assert pftwin("simulate").exit_code == 2
    assert pftwin("no-such-command").exit_code == 2
    assert pftwin("equilibrium", "--case", 7).exit_code == 2


def test_mistakes_of_our_own_are_code_1(monkeypatch):
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("pftwin.geometry.mesh.doctor.examine_file", broken)
    assert pftwin("doctor-mesh", "any.stl").exit_code == ExitCode.UNEXPECTED


def test_an_equilibrium_that_is_not_found_is_code_3(toy, monkeypatch):
    """The patella far in front of the femur, all tendons slack: nothing holds it."""
    scene = toy / "lost.toml"
    text = (toy / "scene.toml").read_text()
    text = text.replace("slack_length_mm = 143.2", "slack_length_mm = 9000").replace(
        "slack_length_m = 0.0714", "slack_length_m = 9"
    )
    scene.write_text(text.replace("position_m = [-0.005, 0.001, 0.05]", "position_m = [0.0, 0.001, 0.3]"))
    done = pftwin("--allow", "most_slack_share=30", "equilibrium", scene, "--json", "-")
    assert done.exit_code == ExitCode.FLAGGED, done.output
    assert json.loads(done.stdout)["converged"] is False
    assert "flagged: toy: no equilibrium was found" in done.stderr


def test_a_mesh_that_is_not_to_be_used_is_code_3(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float) * 0.02
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    save_mesh(SurfaceMesh(corners, faces), tmp_path / "sound.ply")
    save_mesh(SurfaceMesh(corners, np.concatenate([faces, faces[:2, ::-1]])), tmp_path / "bad.ply")
    assert pftwin("doctor-mesh", tmp_path / "sound.ply", "--units", "m").exit_code == ExitCode.DONE
    bad = pftwin("doctor-mesh", tmp_path / "bad.ply", "--units", "m", "--json", tmp_path / "o.json")
    assert bad.exit_code == ExitCode.FLAGGED
    assert "flagged: " in bad.stderr
    assert json.loads((tmp_path / "o.json").read_text())["verdict"].startswith("not to be used")


@pytest.mark.slow
def test_a_run_whose_numbers_are_doubtful_is_code_3_and_is_written(toy, tmp_path, monkeypatch):
    """The flags of a real result, changed: a patch that was left is told only, too long a step is flagged."""
    from pftwin.dynamics import simulate as module
    from pftwin.dynamics.status import Status

    real = module.simulate
    for flag, code in ((Status.LEFT_PATCH, ExitCode.DONE), (Status.STEP_TOO_LONG, ExitCode.FLAGGED)):

        def marked(*args, flag=flag, **kw):
            result = real(*args, **kw)
            result.flags[-1] = int(flag)
            return result

        monkeypatch.setattr(module, "simulate", marked)
        output = tmp_path / f"{flag.name}.nc"
        done = pftwin("simulate", toy / "scene.toml", "-o", output, "--dt", "0.005")
        assert done.exit_code == code, done.output
        assert output.is_file()


def test_an_interrupt_reports_the_files_that_were_written(tmp_path):
    old, new, never = (tmp_path / n for n in ("old", "new", "never"))
    old.write_text("from before")

    def cut_short():
        with report_written_on_interrupt(old, new, never, None):
            new.write_text("now")
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        cut_short()
    assert caught.value.saved == (new,)


def test_the_page_has_every_code():
    text = PAGE.read_text()
    for code in ExitCode:
        assert f"| {code.value} |" in text, code


@pytest.mark.parametrize("invalid", ["before", "after"])
def test_one_of_two_files_of_one_name_that_is_invalid_is_code_3(monkeypatch, capsys, invalid):
    """Results before and after a treatment, in two folders."""
    verdicts = {Path(folder, "knee.nc"): Verdict() for folder in ("before", "after")}
    verdicts[Path(invalid, "knee.nc")] = Verdict((f"no equilibrium {invalid}",))
    monkeypatch.setattr("pftwin.files.result_files.load_dataset", lambda path: path)
    monkeypatch.setattr("pftwin.results.verdict.verdict_of_file", verdicts.__getitem__)
    with pytest.raises(typer.Exit) as left:
        check_trust_of_files(*verdicts)
    assert left.value.exit_code == ExitCode.FLAGGED
    assert f"no equilibrium {invalid}" in capsys.readouterr().err
