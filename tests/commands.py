"""Commands run by tests, in this process."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from pftwin.cli import app


def pftwin(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160", "NO_COLOR": "1"})


def refused(*arguments: object) -> str:
    """The one message of a command that ends with exit code 2."""
    result = pftwin(*arguments)
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    assert result.stdout == ""
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "Traceback" not in result.output
    return result.stderr
