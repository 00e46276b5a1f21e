"""The help as a table of contents, completion, colours."""

from __future__ import annotations

import inspect
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from itertools import groupby
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer import Option
from typer.testing import CliRunner

from pftwin.cli import plugins
from pftwin.cli.program import COMMANDS, app

ROOT = Path(__file__).resolve().parents[2]
COLOUR = re.compile(r"\x1b\[[0-9;]*\b(?:3[0-7]|9[0-7]|38;)[0-9;]*m")


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-m", "pftwin", *arguments]
    kept = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR", "TERM")}
    env = {**kept, "PYTHONPATH": str(ROOT), "COLUMNS": "80", **environment}
    return subprocess.run(program, capture_output=True, text=True, env=env, check=False)


def test_every_command_has_a_panel_and_one_line_of_80_columns():
    text = run("--help").stdout
    lines = text.splitlines()
    for panel, commands in groupby(COMMANDS, lambda c: c.panel):
        head = next(i for i, line in enumerate(lines) if line.startswith(f"╭─ {panel} "))
        for k, command in enumerate(commands, start=1):
            assert lines[head + k].strip("│ ").split(maxsplit=1) == [command.name, command.line], lines[head + k]


def test_the_program_alone_shows_what_people_do_with_lines_to_copy():
    """One after the other: what one writes the next reads. Each stands whole in a terminal of 80 columns."""
    lines = [line.strip() for line in run().stdout.splitlines()]
    jobs = [c.job for c in COMMANDS if c.job is not None]
    assert [job.example.split()[1] for job in jobs] == ["init", "simulate", "fit", "treat"]
    before = lines[: next(i for i, line in enumerate(lines) if line.startswith("╭─ Options"))]
    places = [before.index(job.example) for job in jobs]
    assert places == sorted(places)
    assert [before[k - 1] for k in places] == [f"{job.words}:" for job in jobs]
    program = typer.main.get_command(app)
    for job in jobs:
        _, *arguments = shlex.split(job.example)
        with program.make_context("pftwin", arguments) as above:
            name, command, rest = program.resolve_command(above, arguments)
            command.make_context(name, rest, parent=above).close()  # refuses what the command does not take


@pytest.mark.parametrize("command", COMMANDS, ids=[c.name for c in COMMANDS])
def test_the_help_of_a_command_is_whole_at_80_columns(command):
    """No name of an option and no word of its help is cut."""
    shown = CliRunner().invoke(app, [command.name, "--help"], env={"COLUMNS": "80"}).stdout
    assert "Example: " in shown
    assert "…" not in shown
    flags = {flag for p in typer.main.get_command(app).commands[command.name].params for flag in p.opts if not p.hidden}
    assert {flag for flag in flags if flag.startswith("--")} <= set(re.findall(r"--[\w-]+", shown))


def test_no_command_is_left_out_of_the_table():
    named = {inspect.unwrap(command.run).__module__ for command in COMMANDS}
    files = [p for package in ("pftwin", "fitting") for p in (ROOT / package / "cli").rglob("*.py")]
    commands = [p for p in files if p.read_text(encoding="utf-8").startswith('"""`pftwin ')]
    assert {".".join(p.relative_to(ROOT).with_suffix("").parts) for p in commands} == named


def test_a_package_whose_commands_cannot_be_loaded_is_named_and_the_others_stay(monkeypatch, capsys):
    broken = EntryPoint("theirs", "no_such_package.cli:COMMANDS", plugins.COMMANDS)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [broken, *entry_points(group=group)])
    assert {c.name for c in plugins.installed_commands()} == {c.name for c in COMMANDS}
    assert "'theirs' (no_such_package.cli:COMMANDS) of pftwin.commands cannot be loaded" in capsys.readouterr().err


def test_simulate_does_without_the_options_of_others(monkeypatch):
    monkeypatch.setattr(plugins, "entry_points", lambda group: [])

    def command(scene: str, *, change: Callable[[str], str] | None = None) -> str:
        return scene if change is None else change(scene)

    plain = plugins.with_scene_changes(command)
    assert list(inspect.signature(plain).parameters) == ["scene"]
    assert plain("knee") == "knee"


def test_an_option_can_be_written_by_the_name_that_it_had():
    seen = []

    def command(*, gap: Annotated[str, Option("--gap", help="How far.")] = "1 mm") -> None:
        seen.append(gap)

    program = typer.Typer()
    program.command()(plugins.with_former_names({"gap": "--gap-mm"})(command))
    for arguments in ([], ["--gap", "2"], ["--gap-mm", "3"]):
        assert CliRunner().invoke(program, arguments).exit_code == 0
    assert seen == ["1 mm", "2", "3"]
    for gap in ("2", "1 mm"):  # the default too
        both = CliRunner().invoke(program, ["--gap", gap, "--gap-mm", "3"])
        assert "--gap-mm and --gap given" in str(both.exception)
    assert "--gap-mm" not in CliRunner().invoke(program, ["--help"]).stdout


def test_version():
    from pftwin import __version__

    assert run("--version").stdout == f"pftwin {__version__}\n"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("pftwin hard", "hard-cases"),
        ("pftwin simulate --tto-m", "--tto-medial"),
        ("pftwin simulate --contact s", "spline"),
    ],
)
def test_bash_completes(typed, offered):
    words = {"COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    done = run(_PFTWIN_COMPLETE="complete_bash", **words)
    assert offered in done.stdout.split(), done


@pytest.mark.slow
def test_completion_can_be_shown_for_common_shells():
    for shell in ("bash", "zsh", "fish"):
        done = run(_PFTWIN_COMPLETE=f"source_{shell}")
        assert "_PFTWIN_COMPLETE" in done.stdout, done


@pytest.mark.slow
def test_no_color_is_respected():
    """Colours where they are forced: else the test could not fail."""
    for arguments in (("--help",), ("simulate", "none.toml", "-o", "out.nc")):
        bright = run(*arguments, FORCE_COLOR="1", TERM="xterm-256color")
        plain = run(*arguments, FORCE_COLOR="1", TERM="xterm-256color", NO_COLOR="1")
        assert COLOUR.search(bright.stdout + bright.stderr)
        assert not COLOUR.search(plain.stdout + plain.stderr)
