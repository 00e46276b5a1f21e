"""`pftwin app`: what it offers, says, and refuses, before it serves."""

from __future__ import annotations

import sys

import pytest
from typer.testing import CliRunner

from fitting.cli.live import command
from pftwin.cli import app

RUNNER = CliRunner(env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "neither a scene file nor --case given"),
        (("absent.toml",), "no such file"),
        (("--case", "2", "--contact", "P99"), "P99"),
        (("--case", "2", "--host", "192.0.2.1"), "is no address of this machine; expected: 127.0.0.1"),
    ],
)
def test_mistakes_are_named(arguments, words):
    done = RUNNER.invoke(app, ["app", *arguments])
    assert done.exit_code == 2
    assert words in done.stderr
    assert "Traceback" not in done.output


def test_a_port_is_a_port():
    done = RUNNER.invoke(app, ["app", "--case", "2", "--port", "65536"])
    assert done.exit_code == 2


def test_without_viser_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    done = RUNNER.invoke(app, ["app", "--case", "2"])
    assert done.exit_code == 2
    assert "pip install 'pftwin[app]'" in done.stderr


def test_contacts_that_are_offered():
    assert command.contacts_of(2, "P5") == ("P5", "P2", "P4", "spline", "CM", "FM", "volume")
    assert command.contacts_of(1, "FM")[0] == "FM"
    assert command.contacts_of(None, "P4") == ("P4", "P2", "P5", "spline")
    assert command.contacts_of(None, "contours") == ("contours",)
    assert command.contacts_of(None, None) == ("as in the file",)


@pytest.mark.parametrize(("host", "warns"), [("127.0.0.1", False), ("0.0.0.0", True)])
def test_warns_where_others_can_reach_it(host, warns, capsys):
    command._announce("http://x:1", host, 1.25, safe=not warns)
    said = capsys.readouterr()
    assert said.out == "ready after 1.2 s: http://x:1  (Ctrl-C ends it)\n"
    assert ("warning: 0.0.0.0 can be reached from other machines" in said.err) is warns
