"""The program `pftwin`: its commands, and the reporting of errors and warnings."""

from __future__ import annotations

import sys
import warnings
from typing import Annotated, Any

import typer
from typer import Option
from typer.core import TyperGroup

from pftwin import __version__
from pftwin.base.errors import PftwinError, PftwinWarning
from pftwin.base.written_amounts import numbers_by_name
from pftwin.cli.exit_codes import ExitCode, after_interrupt, code_of, leave_at_once
from pftwin.cli.plugins import installed_commands
from pftwin.cli.scenes import allow_outside, limits
from pftwin.cli.terminal import tell


class _Commands(TyperGroup):
    """Reports pftwin's errors and Ctrl-C as a line on stderr and an exit code; other errors keep their traceback."""

    def invoke(self, ctx: Any) -> Any:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except PftwinError as error:
                tell(f"error: {error}", "red")
                raise typer.Exit(code_of(error)) from None
            except KeyboardInterrupt as error:
                after_interrupt(error)


_show_elsewhere = warnings.showwarning


def _show_warning(message: Any, category: Any, *rest: Any, **options: Any) -> None:
    if isinstance(message, PftwinWarning):
        tell(f"warning: {message}", "yellow")
    else:
        _show_elsewhere(message, category, *rest, **options)


COMMANDS = installed_commands()
_LEAD = "Digital twin of the patellofemoral joint: motion capture in, patellar tracking and forces out."

app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="\n\n".join([_LEAD, *(c.job.markdown for c in COMMANDS if c.job is not None)]),
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"pftwin {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    outside: Annotated[
        bool, Option("--allow-outside", help="Let a trusted scene file use files outside its folder.")
    ] = False,
    allow: Annotated[
        list[str] | None,
        Option(metavar="NAME=VALUE", help="Set a plausibility limit of the knee, by the name in its message."),
    ] = None,
) -> None:
    """Digital twin of the patellofemoral joint: motion capture in, patellar tracking and forces out."""
    allow_outside.set(outside)
    allowed = numbers_by_name(allow, "--allow", "a limit, such as most_mass_kg=5")
    limits.set({name: value for name, (value,) in allowed.items()})


for _command in COMMANDS:
    app.command(_command.name, short_help=_command.line, rich_help_panel=_command.panel)(_command.run)


def main() -> None:
    """The entry point of the program."""
    try:
        app(prog_name="pftwin")
    except SystemExit as ended:
        if ended.code == ExitCode.INTERRUPTED:
            leave_at_once(ExitCode.INTERRUPTED)
        raise
