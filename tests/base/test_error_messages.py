"""Messages of errors."""

from __future__ import annotations

from pftwin.base.errors import InputError


def test_a_message_shortens_what_nobody_could_read():
    error = InputError(f"no column '{'(' * 20_000}'", where="walk.csv, line 1", expected="one of: A, B")
    assert str(error) == f"walk.csv, line 1: no column '{'(' * 59}... (20002 characters); expected: one of: A, B"
    assert "(" * 20_000 in error.problem


def test_a_long_path_is_whole():
    path = "/".join(["folder"] * 60)
    assert str(InputError("no such file", where=path)) == f"{path}: no such file"
