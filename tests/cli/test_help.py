"""The help as a table of contents, completion, colours."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pftwin.cli.app import COMMANDS

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
    for panel, commands in COMMANDS.items():
        head = next(i for i, line in enumerate(lines) if line.startswith(f"╭─ {panel} "))
        for k, (name, _, words) in enumerate(commands, start=1):
            assert lines[head + k].strip("│ ").split(maxsplit=1) == [name, words], lines[head + k]


def test_no_command_is_left_out_of_the_table():
    folder = ROOT / "pftwin" / "cli"
    named = {command.__module__ for commands in COMMANDS.values() for _, command, _ in commands}
    commands = [p for p in folder.rglob("*.py") if p.read_text(encoding="utf-8").startswith('"""`pftwin ')]
    written = {".".join(["pftwin", "cli", *p.relative_to(folder).with_suffix("").parts]) for p in commands}
    assert written == named


def test_version():
    from pftwin import __version__

    assert run("--version").stdout == f"pftwin {__version__}\n"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("pftwin hard", "hard-cases"),
        ("pftwin simulate --med", "--medialise"),
        ("pftwin simulate --contact s", "spline"),
    ],
)
def test_bash_completes(typed, offered):
    words = {"COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    done = run(_PFTWIN_COMPLETE="complete_bash", **words)
    assert offered in done.stdout.split(), done


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
