"""The documentation's table of commands is that of the program."""

from __future__ import annotations

from pathlib import Path

import command_table
import pytest

from pftwin.cli.program import COMMANDS

PAGE = Path(__file__).resolve().parents[2] / "docs" / command_table.PAGE


def test_every_command_stands_in_it():
    page = command_table.filled(PAGE.read_text(encoding="utf-8"))
    for command in COMMANDS:
        assert f"| `pftwin {command.name}` | {command.line} |" in page


def test_a_page_without_a_place_for_it_is_refused():
    with pytest.raises(ValueError, match="no place"):
        command_table.filled("# The command line")
