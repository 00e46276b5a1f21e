"""What long commands show on a terminal while they run: n of N, what comes, and the time left."""

from __future__ import annotations

import io
import re
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from pftwin.cli import app, terminal

CODES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@pytest.fixture
def clock() -> list[float]:
    """The time that a terminal takes it to be [s]."""
    return [0.0]


@pytest.fixture
def screen(monkeypatch, clock) -> io.StringIO:
    """A terminal of 80 columns in the place of stderr."""
    shown = io.StringIO()
    about = {"file": shown, "force_terminal": True, "width": 80, "get_time": lambda: clock[0]}
    monkeypatch.setattr(terminal, "err", lambda: Console(**about))
    return shown


def lines(screen: io.StringIO) -> list[str]:
    return [" ".join(line.split()) for line in re.split(r"[\r\n]+", CODES.sub("", screen.getvalue())) if line.strip()]


def test_a_bar_tells_n_of_n_and_the_time_left(screen, clock):
    """Four of ten in 20 s leave 30 s."""
    with terminal.progress("counting") as shown:
        for done in range(5):
            clock[0] = 5.0 * done
            shown(done, 10, what=f"number {done}")
    last = lines(screen)[-1]
    assert last.startswith("number 4")
    assert last.endswith("4 of 10 00:30 left")
    assert len(last) <= 80


def test_progress_shows_the_time_left_if_a_step_takes_minutes(screen, clock):
    """Four of ten in 16 min leave 24 min."""
    with terminal.progress("counting") as shown:
        for done in range(5):
            clock[0] = 240.0 * done
            shown(done, 10)
    assert lines(screen)[-1].endswith("4 of 10 24:00 left")


def test_an_unknown_time_left_is_not_mentioned(screen, clock):
    """Neither before the work is counted nor before its first step is done."""
    with terminal.progress("searching") as shown:
        clock[0] = 5.0
        shown(0, 4)
    said = lines(screen)
    assert said[0].startswith("searching")
    assert said[-1].endswith("0 of 4")
    assert not any("left" in line or "--:--" in line for line in said)


def test_a_long_label_is_cut_and_not_the_time_left(screen, clock):
    with terminal.progress("simulating " + 5 * "a knee of a long name ") as shown:
        for done in range(5):
            clock[0] = 5.0 * done
            shown(done, 10, f"run {done} of at most 10")
    assert lines(screen)[-1].endswith("run 4 of at most 10 00:30 left")


def test_a_file_in_the_place_of_a_terminal_gets_no_bar(monkeypatch):
    plain = io.StringIO()
    monkeypatch.setattr(terminal, "err", lambda: Console(file=plain, width=80))
    with terminal.progress("counting") as shown:
        shown(1, 2)
    assert plain.getvalue().strip() == ""


@pytest.mark.parametrize(
    ("command", "work"),
    [
        (["audit"], "pftwin.studies.audit.audit.audit"),
        (["explain"], "pftwin.studies.audit.explain.explain"),
        (
            ["optimise", "--limit", "mean_tilt<=3 deg", "--tto-medial", "0:20"],
            "fitting.treatments.optimise.optimise_treatment",
        ),
        (["plan-experiment"], "fitting.identifiability.plan_experiment"),
    ],
)
def test_long_commands_show_how_far_they_are(command, work, screen, monkeypatch):
    def half(*_: Any, progress: Any, **options: Any) -> None:
        progress(3, 6, "without gravity")
        raise KeyboardInterrupt

    monkeypatch.setattr(work, half)
    done = CliRunner().invoke(app, [*command, "--case", "1"])
    assert done.exit_code == 130, done.output
    assert any(line.startswith("without gravity") and "3 of 6" in line for line in lines(screen))


def test_hard_cases_shows_how_many_cells_are_done(screen, monkeypatch):
    """Half of the 4 cells of one case: by two integrators in two float types."""

    def half(cases: Any, chosen: Any, say: Any, count: Any) -> None:
        count(2)
        raise KeyboardInterrupt

    monkeypatch.setattr("pftwin.studies.hard_cases.run_matrix", half)
    asked = ["--case", "plain_knee", "--contact", "P5", "--integrator", "newmark", "--integrator", "linear_implicit"]
    done = CliRunner().invoke(app, ["hard-cases", *asked])
    assert done.exit_code == 130, done.output
    assert any(line.startswith("cells") and "2 of 4" in line for line in lines(screen))


def test_hard_cases_into_a_folder_shows_how_many_files_are_done(screen, monkeypatch, tmp_path):
    def half(*_: Any, progress: Any, **options: Any) -> None:
        progress(3, 6)
        raise KeyboardInterrupt

    monkeypatch.setattr("pftwin.studies.hard_cases.whole.run_missing", half)
    done = CliRunner().invoke(app, ["hard-cases", "--into", str(tmp_path)])
    assert done.exit_code == 130, done.output
    assert any(line.startswith("contacts and integrators") and "3 of 6" in line for line in lines(screen))


def test_simulate_shows_which_run_it_is(screen, monkeypatch, tmp_path):
    def second(*_: Any, progress: Any, **options: Any) -> None:
        progress(8, 28, "run 2 of at most 3")
        raise KeyboardInterrupt

    monkeypatch.setattr("pftwin.dynamics.simulate.simulate", second)
    done = CliRunner().invoke(app, ["simulate", "--case", "1", "-o", str(tmp_path / "out.nc")])
    assert done.exit_code == 130, done.output
    assert any("run 2 of at most 3" in line for line in lines(screen))


def test_import_shows_its_stages(screen, monkeypatch, tmp_path):
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pftwin.files.interchange.osim_scene.import_osim", lambda *_, **options: None)
    monkeypatch.setattr("pftwin.cli.exchange._loaded", interrupted)
    done = CliRunner().invoke(app, ["import", "knee.osim", "-o", str(tmp_path / "knee")])
    assert done.exit_code == 130, done.output
    assert any(line.startswith("loading the scene") and "1 of 2" in line for line in lines(screen))


def test_the_fits_of_the_demo_show_how_far_they_are(screen, monkeypatch, tmp_path):
    """Three fits in six steps; each by simulations has two, of which half of the first is done."""
    from fitting.demo import paper_study

    def half(*_: Any, progress: Any, **options: Any) -> None:
        progress(1024, 2048)
        raise KeyboardInterrupt

    monkeypatch.setattr("fitting.demo.cases.run_demo", lambda folder, shown, full: ({"figures": []}, []))
    monkeypatch.setattr(paper_study, "fit_tendons", lambda *_, **options: SimpleNamespace(reason="converged"))
    monkeypatch.setattr(paper_study, "train_posterior", half)
    done = CliRunner().invoke(app, ["demo", "--out", str(tmp_path / "demo")])
    assert done.exit_code == 130, done.output
    assert any(line.startswith("fit B: simulating 2,048 knees") and "1 of 6" in line for line in lines(screen))
