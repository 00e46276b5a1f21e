"""The program `pftwin`: its commands, and how errors reach the user."""

from __future__ import annotations

import sys
import warnings
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from pftwin.cli import (
    accuracy,
    audit,
    contact_map,
    demo,
    doctor_mesh,
    equilibrium,
    explain,
    fit,
    fit_surface,
    hard_cases,
    init,
    optimise,
    plan_experiment,
    simulate,
    treat,
    validate,
    view,
)
from pftwin.cli.live import command as live
from pftwin.cli.terminal import err
from pftwin.errors import PftwinError, PftwinWarning


class _Commands(TyperGroup):
    """Errors meant for the user become a line on stderr and exit code 2; all others keep their traceback."""

    def invoke(self, ctx: Any) -> Any:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except PftwinError as error:
                err().print(f"error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
                raise typer.Exit(2) from None


_show_elsewhere = warnings.showwarning


def _show_warning(message: Any, category: Any, *rest: Any, **options: Any) -> None:
    if isinstance(message, PftwinWarning):
        err().print(f"warning: {message}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    else:
        _show_elsewhere(message, category, *rest, **options)


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Digital twin of the patellofemoral joint: motion capture in, patellar tracking and forces out.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from pftwin import __version__

        sys.stdout.write(f"pftwin {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and end.")
    ] = False,
) -> None:
    """Digital twin of the patellofemoral joint: motion capture in, patellar tracking and forces out."""


app.command("demo")(demo.demo)
app.command("simulate")(simulate.simulate)
app.command("equilibrium")(equilibrium.equilibrium)
app.command("validate")(validate.validate)
app.command("accuracy")(accuracy.accuracy)
app.command("explain")(explain.explain)
app.command("audit")(audit.audit)
app.command("fit")(fit.fit)
app.command("plan-experiment")(plan_experiment.plan_experiment)
app.command("fit-surface")(fit_surface.fit_surface)
app.command("doctor-mesh")(doctor_mesh.doctor_mesh)
app.command("contact-map")(contact_map.contact_map)
app.command("hard-cases")(hard_cases.hard_cases)
app.command("treat")(treat.treat)
app.command("optimise")(optimise.optimise)
app.command("view")(view.view)
app.command("app")(live.app)
app.command("init")(init.init)


def main() -> None:
    """The entry point of the program."""
    app()
