"""Exit codes of the program, the same for all commands, and functions that end a command with them."""

from __future__ import annotations

import enum
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import typer

from pftwin.base.errors import InputError, MissingExtraError, OutputError, PftwinError
from pftwin.cli.terminal import tell

if TYPE_CHECKING:
    from pftwin.results.result import Result


class ExitCode(enum.IntEnum):
    """Exit code of a command; docs/command_line.md has the same table."""

    DONE = 0
    UNEXPECTED = 1  # a bug in pftwin: the traceback is shown
    BAD_INPUT = 2  # invalid options or files, an unwritable output, a missing package
    FLAGGED = 3  # the command ran, but there is no result, or it is not reliable
    INTERRUPTED = 130  # by Ctrl-C


_REFUSALS = (InputError, OutputError, MissingExtraError)


def code_of(error: PftwinError) -> ExitCode:
    """Returns the exit code of an error that is meant for the user."""
    return ExitCode.BAD_INPUT if isinstance(error, _REFUSALS) else ExitCode.FLAGGED


def exit_flagged(why: str) -> NoReturn:
    """Ends a command whose result is written and shown but is not reliable; writes the reason to stderr."""
    tell(f"flagged: {why}", "yellow")
    raise typer.Exit(ExitCode.FLAGGED)


def check_trust(result: Result) -> None:
    """Ends with `FLAGGED` if a motion is not valid (`pftwin.results.verdict`) or frames are inaccurate.

    Of a motion that is not valid, the command has already shown the reasons.
    """
    from pftwin.dynamics.status import Status
    from pftwin.results.verdict import INVALID

    if not result.verdict.valid:
        exit_flagged(f"{result.scene_name} is {INVALID}")
    if inaccurate := result.status & Status.INACCURATE:
        exit_flagged(f"{inaccurate.describe()} ({result.scene_name})")


def check_trust_of_files(*paths: Path) -> None:
    """Ends with `FLAGGED` if the motion in any of these files of results is not valid."""
    from pftwin.files.result_files import load_dataset
    from pftwin.results.verdict import verdict_of_file

    verdicts = [(path, verdict_of_file(load_dataset(path))) for path in paths]
    if doubts := [f"{verdict.describe()} ({path.name})" for path, verdict in verdicts if not verdict.valid]:
        exit_flagged("; ".join(doubts))


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with the files of results saved before it; None and stdout ("-") are skipped."""

    def __init__(self, *saved: Path | str | None) -> None:
        super().__init__()
        self.saved = tuple(path for path in saved if path not in (None, "-"))


@contextmanager
def report_written_on_interrupt(*files: Path | None) -> Iterator[None]:
    """Converts Ctrl-C during the work inside to `Interrupted` with those of the files that it has written."""
    before = {f: _version(f) for f in files if f is not None}
    try:
        yield
    except Interrupted:
        raise
    except KeyboardInterrupt:
        raise Interrupted(*(f for f, old in before.items() if _version(f) not in (None, old))) from None


def after_interrupt(error: KeyboardInterrupt) -> NoReturn:
    """Reports which files were saved, and ends with `INTERRUPTED`."""
    saved = error.saved if isinstance(error, Interrupted) else ()
    words = f"saved so far: {', '.join(map(str, saved))}" if saved else "nothing was saved"
    tell(f"interrupted; {words}", "yellow")
    raise typer.Exit(ExitCode.INTERRUPTED)


def leave_at_once(code: ExitCode) -> NoReturn:
    """Ends the process without Python's shutdown, which crashes if compiled code still runs in threads."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def _version(file: Path) -> tuple[int, int] | None:
    """Identifies the version of a file (time of modification and inode); None if it does not exist."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino
